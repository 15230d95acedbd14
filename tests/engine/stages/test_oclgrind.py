"""Oclgrind finds no access out of bounds and no data race in any kernel."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from parameters import few

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("case", few(["int64", "int32", "upload", "dilate-splat", "scene"], "dilate-splat"))
def test_oclgrind_reports_nothing(case, tmp_path):
    if shutil.which("oclgrind") is None:
        assert not os.environ.get("CI"), "CI must have oclgrind"
        pytest.skip("oclgrind is not installed")
    log = tmp_path / "oclgrind.log"
    environment = {k: v for k, v in os.environ.items() if k not in ("GFFE_DEVICE", "OCL_ICD_VENDORS")}
    child = subprocess.run(
        [
            *("oclgrind", "--data-races", "--log", str(log)),
            *(sys.executable, str(Path(__file__).with_name("oclgrind_case.py")), case),
        ],
        capture_output=True,
        text=True,
        env=environment | {"PYOPENCL_NO_CACHE": "1"},
        timeout=900,
    )
    assert f"finished {case}" in child.stdout, child.stderr[-2000:]
    report = log.read_text() if log.exists() else ""
    assert not report.strip(), report[:4000]
