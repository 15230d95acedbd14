"""Installed copies: what a wheel holds, and that it works with the newest and the lowest versions of what it needs."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest
from xvfb import require_screen

ROOT = Path(__file__).parents[1]
PARTS = {"gffe_cl": "gffe_cl", "kernels": "gffe_cl/kernels", "viewer": "gffe_cl/viewer"}  # folders of the package
TRY = ROOT / "tests" / "helpers" / "try_installed.py"
pytestmark = pytest.mark.long


def uv(*arguments):
    """Run uv, the one of this environment."""
    command = [sys.executable, "-m", "uv", "--quiet", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a source distribution, as by installers that find no wheel, with things in it that are nobody's."""
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("built")
    for name in PARTS:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in (".env", "notes.txt~", "engine/.secret", "engine/export/c/.DS_Store"):
        (source / "gffe_cl" / name).write_text("not for others")
    (source / "gffe_cl" / "again").symlink_to(source / "gffe_cl")
    (source / "kernels" / "up").symlink_to("..")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GITHUB_REPOSITORY", "someone/gffe-cl")
        uv("build", "--out-dir", built, source)
    (path,) = built.glob("*.whl")
    return path


def test_wheel_holds_the_package_and_nothing_else(wheel):
    """Kernels, shaders and weights included; tests, hidden files, backups and links to folders out."""
    there = {
        f"{inside}/{path.relative_to(ROOT / name).as_posix()}"
        for name, inside in PARTS.items()
        for path in (ROOT / name).rglob("*")
        if path.is_file() and path.parent.name != "__pycache__"
    }
    (about,) = (name for name in ZipFile(wheel).namelist() if name.endswith(".dist-info/METADATA"))
    about = ZipFile(wheel).read(about).decode()
    assert "Project-URL: Source, https://github.com/someone/gffe-cl\n" in about
    assert not re.findall(r"\]\((?!https?:|#)", about) and "/raw/main/docs/pictures/demo.webp" in about
    held = {name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert held == there
    assert {".cl", ".h", ".c", ".onnx", ".frag", ".vert", ".bin"} <= {Path(name).suffix for name in held}


LAB = ("-r", ROOT / "pyproject.toml", "--extra", "lab", "--extra", "video")
ENGINE = ("numpy", "pyopencl", "platformdirs")  # docs/guide.md: for programs that link the engine only


@pytest.mark.parametrize(
    ("needs", "part"),
    [
        (LAB, "--all"),
        ((*LAB, "--resolution", "lowest-direct"), "--quick"),
        (LAB[:2], "--default"),
        (ENGINE, "--engine"),
    ],
    ids=["newest", "lowest", "default", "engine"],
)
def test_wheel_works(wheel, needs, part, tmp_path):
    """In an environment that has nothing but it and the versions that it asks for: all of it with the newest, the
    demonstration and the self-test with the lowest, what needs no extras without any, the engine with what it needs.
    Intel's runtime is this one's."""
    require_screen()
    fresh, working = tmp_path / "environment", tmp_path / "working"
    working.mkdir()
    uv("venv", "--python", sys.executable, fresh)
    uv("pip", "install", "--python", fresh, "--only-binary", ":all:", *needs)
    uv("pip", "install", "--python", fresh, "--no-deps", wheel)
    for path in (Path(sys.prefix) / "lib").iterdir():
        if path.is_file() and not (fresh / "lib" / path.name).exists():
            (fresh / "lib" / path.name).symlink_to(path)
    command = [fresh / "bin" / "python", "-I", TRY, part]
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "OCL_ICD_VENDORS")}
    done = subprocess.run(command, cwd=working, env=environment, capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("installed copy: passed\n")
