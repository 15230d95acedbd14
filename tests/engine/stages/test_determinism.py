"""The same frames give the same bits: in each run, and on each device."""

import pytest
from twin_cases import run

from gffe_cl.engine.opencl.device import list_devices, open_info
from gffe_cl.engine.options import Options


@pytest.mark.parametrize("options", [Options(history=3, order=2), Options()], ids=["order 2", "acceleration"])
def test_devices_agree(options):
    """All usable devices give the same bits in every buffer that can be compared."""
    infos = [info for info in list_devices() if info.works and info.platform != "Oclgrind"]
    if len(infos) < 2:
        pytest.skip("needs two devices")
    results = []
    for info in infos:
        pipeline = run(open_info(info), 96, 64, options).pipeline
        results.append({f"{s.name}.{b.name}": s.read(b.name) for s, b in pipeline.named_buffers()})
    for name, first in results[0].items():
        for other in results[1:]:
            assert first.tobytes() == other[name].tobytes(), name
