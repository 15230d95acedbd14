"""Bytes and instructions of kernels, as Oclgrind counts them."""

import json
import os
import shutil
import sys
from pathlib import Path

import pytest

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.pipeline.outputs import STAGES
from gffe_cl.engine.stages.holes import FILLINGS
from gffe_cl.lab.bench import scene_loop

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "tools"))
import count_traffic  # noqa: E402

TABLE = ROOT / "docs" / "measured" / "traffic.json"
RECORD = "python docs/tools/count_traffic.py --lanes 1,8 --write && python docs/tools/make_performance.py"

PRINTED = """
Instructions executed for kernel 'splat':
            2048 - getelementptr
            1024 - load global (4096 bytes)
             512 - load private (512 bytes)
             256 - store global (1024 bytes)
             100 - call _Z11vload_half4mPU3AS1KDh()
              10 - call _Z16vstore_half4_rteDv4_fmPU3AS1Dh()
               7 - call _Z6vload8mPU3AS1Kf()
               5 - call _Z7vstore8Dv8_fmPU3AS1f()
               3 - call _Z8atom_minPU3AS1Vmm()
               2 - call _Z10vload_halfmPU3AS1KDh()
               1 - call _Z6vload4mPU3AS3Kf()
               1 - call _Z10atomic_incPU3AS1Vj()
               1 - call llvm.memcpy.p1i8.p0i8.i64()

Instructions executed for kernel 'set_frame':
               1 - call llvm.memcpy.p1i8.p0i8.i64()

Instructions executed for kernel 'clear':
             512 - store global (2048 bytes)
"""


def test_counts_are_parsed():
    loaded = 4096 + 100 * 8 + 7 * 32 + 3 * 8 + 2 * 2 + 4
    stored = 1024 + 10 * 8 + 5 * 32 + 3 * 8 + 4
    executed = 1024 + 256 + 100 + 10 + 7 + 5 + 3 + 2 + 1 + 1 + 1  # neither addresses nor private memory
    assert list(count_traffic.parse_counts(PRINTED)) == [("splat", loaded, stored, executed), ("clear", 0, 2048, 512)]
    with pytest.raises(GffeError, match="how many bytes"):
        list(count_traffic.parse_counts(PRINTED + "   3 - call _Z21async_work_group_copyPU3AS3fPU3AS1Kfm9ocl_event()"))


def test_kernels_are_told_by_their_names():
    """Oclgrind prints names of kernels, not of their files."""
    for filling in FILLINGS.values():
        stages = [stage for stage in STAGES if stage.name != "holes"] + ([filling] if filling else [])
        names = [kernel.name for stage in stages for kernel in stage.kernels]
        assert len(names) == len(set(names))


@pytest.fixture(scope="module")
def loop():
    table = json.loads(TABLE.read_text())
    return scene_loop(open_device(), table["of"], *table["size"])


@pytest.mark.long
@pytest.mark.parametrize("lanes", [1, 8])
def test_traffic_does_not_grow(loop, lanes):
    """Instructions by more than 2% of a kernel's, bytes by more than 5%, and half of one per pixel: the scene is
    rendered with the runtime's sines, and kernels that skip groups of pixels by what they see skip others."""
    if shutil.which("oclgrind") is None:
        assert not os.environ.get("CI"), "CI must have oclgrind"
        pytest.skip("oclgrind is not installed")
    recorded = json.loads(TABLE.read_text())["lanes"][str(lanes)]
    now = count_traffic.count(loop, lanes)
    assert set(now) == set(recorded), f"If that is meant to be: {RECORD}"
    for name, moved in now.items():
        old = recorded[name]
        for what, before, after, most in (
            ("bytes", old["loaded"] + old["stored"], moved.loaded + moved.stored, 1.05),
            ("instructions", old["executed"], moved.executed, 1.02),
        ):
            told = f"{name}: {after:.1f} {what} per pixel, recorded {before:.1f}. If meant: {RECORD}"
            assert after <= most * before + 0.5, told
