"""Installed copies: what a wheel holds, and that it works with the newest and the lowest versions of what it needs."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path
from zipfile import ZipFile

import pytest
from xvfb import require_screen

from gffe_cl import __version__

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
def built(tmp_path_factory):
    """Folder of a source distribution, and of the wheel built from that, as by installers that find no wheel; with
    things in the source that are nobody's."""
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("built")
    for name in (*PARTS, ".ci", "docs", "tests"):
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for path in ROOT.iterdir():
        if path.is_file() and not path.name.startswith("."):
            shutil.copy(path, source)
    for name in (".env", "notes.txt~", "engine/.secret", "engine/export/c/.DS_Store"):
        (source / "gffe_cl" / name).write_text("not for others")
    (source / "gffe_cl" / "again").symlink_to(source / "gffe_cl")
    (source / "kernels" / "up").symlink_to("..")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GITHUB_REPOSITORY", "someone/gffe-cl")
        uv("build", "--out-dir", built, source)
    return built


@pytest.fixture
def wheel(built):
    (path,) = built.glob("*.whl")
    return path


def test_source_distribution_runs_its_tests(built, tmp_path):
    """... and has all of them, with the documentation that they read."""
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        archive.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    for name in ("docs", "tests"):
        held, there = (
            {path.relative_to(root).as_posix() for path in (root / name).rglob("*") if path.is_file()}
            for root in (source, ROOT)
        )
        assert held == {path for path in there if "__pycache__" not in path and not Path(path).name.startswith(".")}
    chosen = ("tests/test_gone.py", "tests/engine/frame/test_camera.py")
    command = [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider", "-m", "not long", *chosen]
    environment = os.environ | {"PYTHONPATH": str(source)}
    done = subprocess.run(command, cwd=source, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0 and "failed" not in done.stdout, done.stdout + done.stderr


def test_image_has_a_demonstration(built, tmp_path):
    """The Dockerfile's steps, in a fresh environment in place of a container: Debian's packages are those of CI."""
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    runs = [step.split() for line in lines if line.startswith("RUN ") for step in line[4:].split(" && ")]
    (packages,) = (run[4:] for run in runs if run[:2] == ["apt-get", "install"])
    (words,) = (run[3:] for run in runs if run[:3] == ["pip", "install", "--no-cache-dir"])
    assert "USER nobody" in lines and set(packages) <= set((ROOT / ".ci/run").read_text().split())
    (source,) = built.glob("*.tar.gz")
    places = {
        "-c": "-c",
        "/source/constraints.txt": ROOT / "constraints.txt",
        "'/source[lab,video]'": f"{source}[lab,video]",
    }
    uv("venv", "--python", sys.executable, tmp_path / "environment")
    uv("pip", "install", "--python", tmp_path / "environment", *(places[word] for word in words))
    (demo,) = (json.loads(line[4:]) for line in lines if line.startswith("CMD "))
    (variables,) = (dict(word.split("=") for word in line[4:].split()) for line in lines if line.startswith("ENV "))
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment = variables | environment | {"GFFE_DEVICE": variables["GFFE_DEVICE"]}  # caches of programs as ever
    command = [tmp_path / "environment/bin" / demo[0], *demo[1:], "--size", "64x36"]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=600)
    assert (tmp_path / "out/demo/contact_sheet.png").is_file()


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


def test_conda_recipe_asks_for_what_the_package_does():
    project, recipe = (tomllib.loads((ROOT / "pyproject.toml").read_text())["project"], ROOT / ".ci/recipe.yaml")
    wanted = {*project["dependencies"], *project["optional-dependencies"]["lab"][:2]}
    held = {" ".join(re.split("(?=>=)", each)).lower().replace("openexr", "openexr-python") for each in wanted}
    text, of_the_viewer = recipe.read_text(), {name for name in held if name.startswith(("glfw", "imgui", "moderngl"))}
    run = text[text.index("  run:") : text.index("tests:")]
    assert set(re.findall("    - (.*)", run)) == held - of_the_viewer | {"pocl", f"python {project['requires-python']}"}
    assert f'version: "{__version__}"' in text and f"version: {__version__}\n" in (ROOT / "CITATION.cff").read_text()


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
