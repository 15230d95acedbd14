"""Where tests are: a kernel's are found by its name, and none depends on another."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
IMPORTS_A_TEST = re.compile(r"^\s*(?:from|import) test_\w+", re.M)


def kernels_without_tests(kernels, tests):
    """Names of kernel files for which there is no test of their name; those are sought in all folders."""
    found = {path.stem.removeprefix("test_") for path in tests}
    return sorted(path.name for path in kernels if path.stem not in found)


def test_every_kernel_file_has_a_test_of_its_name():
    kernels, tests = list((ROOT / "kernels").glob("*.cl")), list((ROOT / "tests").rglob("test_*.py"))
    assert len(kernels) > 20 and kernels_without_tests(kernels, tests) == []
    assert kernels_without_tests([*kernels, Path("blur.cl")], tests) == ["blur.cl"]


def test_no_test_imports_another():
    """Neither do their child processes; what tests share is in tests/helpers."""
    importing = [
        path.relative_to(ROOT).as_posix()
        for path in sorted((ROOT / "tests").rglob("*.py"))
        if IMPORTS_A_TEST.search(path.read_text("utf-8"))
    ]
    assert importing == []
    assert IMPORTS_A_TEST.search("import sys\n    from test_device import GPU\n")
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["pytest"]["ini_options"]
    assert settings["pythonpath"] == ["tests/helpers"]
