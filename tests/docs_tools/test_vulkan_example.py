"""The sample in C++ with Vulkan, on a Vulkan for CPUs and PoCL: with copies, and with shared memory by a driver that
stands in for one of a GPU. Needs cmake, glslangValidator, Vulkan's headers and a Vulkan device."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from exported import require_compiler

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "vulkan"
STAND_IN = Path(__file__).parents[1] / "helpers" / "shares_vulkan.c"
VENDORS = Path("/etc/OpenCL/vendors")

pytestmark = [pytest.mark.long, pytest.mark.skipif(sys.platform != "linux", reason="descriptors are Linux's")]


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The built sample."""
    require_compiler("cc", "c++", "cmake", "glslangValidator")
    if subprocess.run(["cc", "-E", "-"], input="#include <vulkan/vulkan.h>", text=True, capture_output=True).returncode:
        pytest.skip("no vulkan/vulkan.h (Debian: libvulkan-dev)")
    if not list(VENDORS.glob("pocl*.icd")):
        pytest.skip("no PoCL of the system's")
    folder = tmp_path_factory.mktemp("vulkan")
    command = [sys.executable, "-m", "gffe_cl", "export", folder / "c", "--no-scn", "--device", "pocl"]
    subprocess.run(command, check=True, capture_output=True)
    strict = "-Wall -Wextra -Wpedantic -Werror -Wno-missing-field-initializers"
    given = [f"-DGFFE_C={folder / 'c'}", f"-DCMAKE_CXX_FLAGS={strict}"]
    subprocess.run(["cmake", "-S", EXAMPLE, "-B", folder / "build", *given], check=True, capture_output=True)
    built = subprocess.run(["cmake", "--build", folder / "build"], capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder / "build" / "gffe_vulkan"


def ran(program, out, *words, **environment):
    # None of what this process loads for Intel's runtime.
    kept = {name: value for name, value in os.environ.items() if name not in ("LD_PRELOAD", "OCL_ICD_VENDORS")}
    command = [program, out, "--platform", "Portable", "--size", "161x91", *words]
    found = subprocess.run(command, capture_output=True, text=True, timeout=300, env=kept | environment)
    if "no Vulkan device" in found.stderr or "vkCreateInstance" in found.stderr:
        pytest.skip("no Vulkan device (Debian: mesa-vulkan-drivers)")
    return found


def test_frames_gain_over_repeating(program, tmp_path):
    found = ran(program, tmp_path, "--frames", "8", "--compare")
    assert found.returncode == 0 and found.stdout.endswith("copied in both ways\n"), found.stderr
    repeated, generated = map(float, re.findall(r"(\d+\.\d+) dB", found.stdout))
    assert "buffers are copied" in found.stdout and generated > repeated + 1
    for name in ("rendered", "generated", "truth"):
        assert (tmp_path / f"{name}.ppm").stat().st_size == 3 * 161 * 91 + len("P6\n161 91\n255\n")


@pytest.mark.parametrize(("semaphores", "waits"), [("without", 3), ("with", 1)])
def test_shared_memory_gives_the_same_bits(program, tmp_path, semaphores, waits):
    """With semaphores the host waits only for the picture that it reads."""
    driver = tmp_path / "driver.so"
    subprocess.run(["cc", "-shared", "-fPIC", STAND_IN, "-o", driver, "-lvulkan", "-ldl"], check=True)
    more = {"WITHOUT_SEMAPHORES": "1"} if semaphores == "without" else {}
    found = ran(program, tmp_path, "--frames", "8", "--compare", LD_PRELOAD=str(driver), **more)
    if "shared" not in found.stdout:
        pytest.skip("this Vulkan device exports no memory by descriptors")
    assert found.returncode == 0 and found.stdout.endswith("the same bits both ways\n"), found.stdout + found.stderr
    assert f"the host waits {waits} times a frame, {semaphores} semaphores" in found.stdout


def test_a_capture_passes_the_doctor(program, tmp_path):
    found = ran(program, tmp_path, "--frames", "6", "--capture", str(tmp_path / "capture"))
    assert found.returncode == 0, found.stderr
    command = [sys.executable, "-m", "gffe_cl", "check", tmp_path / "capture"]
    told = subprocess.run(command, capture_output=True, text=True)
    assert told.returncode == 0 and "6 rendered frames, 161×91" in told.stdout, told.stdout + told.stderr
    assert "fault" not in told.stdout and "warning" not in told.stdout, told.stdout


def test_faults_are_one_line(program, tmp_path):
    for words in (["--platform", "No such"], ["--frames", "no"], ["--size", "0x0"]):
        found = ran(program, tmp_path, *words)
        assert found.returncode == 2 and len(found.stderr.splitlines()) == 1, words
    assert "cannot be written" in ran(program, tmp_path / "none", "--frames", "3").stderr
