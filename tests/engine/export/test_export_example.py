"""The exported folder as a user has it: compiled by strict C and C++ compilers, run as a program of its own, watched by
sanitizers."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exported import STRICT, require_compiler

COUNT = 8  # frames of the example
SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")
LINKED_BY_OTHERS = "-Wl,--unresolved-symbols=ignore-in-shared-libs"
SUPPRESSED = "".join(f"leak:{name}\n" for name in ("libpocl", "libOpenCL", "libLLVM", "libclang", "ld-linux"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An export, as the command writes it."""
    require_compiler("cc", "c++")
    out = tmp_path_factory.mktemp("exported") / "c"
    command = [sys.executable, "-m", "gffe_cl", "export", str(out)]
    pocl = {"GFFE_DEVICE": "pocl"} if list(SYSTEM_VENDORS.glob("pocl*.icd")) else {}
    subprocess.run(command, check=True, capture_output=True, env=os.environ | pocl)
    return out


@pytest.fixture(scope="module")
def loader(tmp_path_factory):
    """How to link OpenCL's loader, and the environment in which it finds PoCL alone."""
    require_compiler("cc")
    environment = {k: v for k, v in os.environ.items() if k not in ("LD_PRELOAD", "OCL_ICD_VENDORS")}
    if not list(SYSTEM_VENDORS.glob("pocl*.icd")):
        pytest.skip("no PoCL of the system's")
    vendors = tmp_path_factory.mktemp("vendors")
    for path in SYSTEM_VENDORS.glob("pocl*.icd"):
        (vendors / path.name).write_text(path.read_text())
    environment["OCL_ICD_VENDORS"] = str(vendors)
    for folder in (*os.environ.get("LIBRARY_PATH", "").split(":"), "", f"{sys.prefix}/lib"):
        found = f"{folder}/libOpenCL.so"
        link = [found] if folder and Path(found).exists() else ["-lOpenCL"]
        empty = tmp_path_factory.mktemp("loader") / "none"
        run = ["cc", "-x", "c", "-", "-x", "none", *link, "-o", str(empty), LINKED_BY_OTHERS]
        if not subprocess.run(run, input="int main(void) { return 0; }", text=True, capture_output=True).returncode:
            extra = {"LD_LIBRARY_PATH": folder} if folder else {}
            return [*link, LINKED_BY_OTHERS, "-lm"], environment | extra
    pytest.skip("no libOpenCL to link (Debian: ocl-icd-opencl-dev)")


def sources(folder):
    return sorted(map(str, folder.glob("*.c")))


def compiled(folder, loader, name, *flags):
    """A program of the folder's sources."""
    command = ["cc", "-std=c99", *STRICT, *flags, *sources(folder), "-o", str(folder / name), *loader[0]]
    subprocess.run(command, check=True)
    return folder / name


def example(loader, *arguments, **environment):
    """The finished process of the example."""
    return subprocess.run(arguments, env=loader[1] | environment, capture_output=True, text=True, timeout=300)


def test_strict_compilers_of_c_and_cpp_take_it(folder):
    for command in (["cc", "-std=c99"], ["c++", "-x", "c++"]):
        subprocess.run([*command, *STRICT, "-fsyntax-only", *sources(folder)], check=True)
    if shutil.which("clang"):
        subprocess.run(["clang", "-std=c99", *STRICT, "-fsyntax-only", *sources(folder)], check=True)


def test_the_readme_calls_what_there_is(folder):
    names = {path.name for path in folder.iterdir()}
    assert {"gffe.h", "gffe.c", "main.c", "CMakeLists.txt", "README.md", "kernels"} <= names
    readme = (folder / "README.md").read_text()
    declared = (folder / "gffe.h").read_text()
    called = set(re.findall(r"\b(gffe_\w+)\(", readme))
    assert len(called) >= 8 and called <= set(re.findall(r"\b(gffe_\w+)\(", declared))


def middle_of_the_square(path):
    """The mean column of the red pixels in a picture."""
    head, pixels = path.read_bytes().split(b"\n255\n", 1)
    width, height = map(int, head.split()[1:])
    image = np.frombuffer(pixels, np.uint8).reshape(height, width, 3).astype(int)
    columns = np.nonzero(image[..., 0] - image[..., 1] > 100)[1]
    assert len(columns) > 1000
    return columns.mean()


def test_the_example_makes_frames_in_between_and_leaks_nothing(folder, loader, tmp_path):
    program = compiled(folder, loader, "watched", "-g", "-O1", "-fsanitize=address,undefined")
    (folder / "suppressed").write_text(SUPPRESSED)
    watch = {"LSAN_OPTIONS": f"suppressions={folder / 'suppressed'}", "UBSAN_OPTIONS": "halt_on_error=1"}
    ran = example(loader, program, tmp_path, "Portable", **watch)
    if "LeakSanitizer has encountered a fatal error" in ran.stderr:
        pytest.skip("leaks cannot be looked for here (no ptrace)")
    assert ran.returncode == 0, ran.stderr
    rendered, made = (
        [middle_of_the_square(tmp_path / f"{kind}_{k:02}.ppm") for k in range(COUNT)] for kind in ("rendered", "made")
    )
    step = rendered[1] - rendered[0]
    assert step > 3  # the first one, after a reset, stays in its place
    np.testing.assert_allclose(np.subtract(made, rendered)[1:], step / 2, atol=0.25)


def test_the_example_says_what_is_wrong(folder, loader, tmp_path):
    program = compiled(folder, loader, "plain", "-O1")
    for arguments, wanted in (
        ((), "usage"),
        ((tmp_path / "none", "Portable"), "cannot be written"),
        ((tmp_path, "No such"), "there is no such platform"),
    ):
        ran = example(loader, program, *arguments)
        assert ran.returncode == 2 and wanted in ran.stderr and len(ran.stderr.splitlines()) == 1


@pytest.mark.long
def test_the_readme_s_commands_work_as_they_are(folder, loader, tmp_path):
    require_compiler("cmake")
    copy = tmp_path / "c"
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("out", "build"))
    commands = [line for line in (copy / "README.md").read_text().splitlines() if line.startswith("    ")][:2]
    given = {"LDFLAGS": LINKED_BY_OTHERS}
    given["CMAKE_LIBRARY_PATH"] = str(Path(loader[0][0]).parent) if loader[0][0].endswith(".so") else ""
    given["CMAKE_INCLUDE_PATH"] = os.environ.get("C_INCLUDE_PATH", "")
    subprocess.run(["sh", "-ec", "\n".join(commands)], cwd=copy, env=loader[1] | given, check=True, timeout=600)
    assert len(list((copy / "out").glob("*.ppm"))) == 2 * COUNT
