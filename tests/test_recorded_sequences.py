"""What `gffe run` writes, to the bit: eight scenes and four encodings of games, small, compared with recorded digests.

python tests/test_recorded_sequences.py        records them anew in recorded_sequences.json, after a change of bits
"""

import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from gffe_cl.captures.scenes import SCENES
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.engine.opencl.device import list_devices

RECORD = Path(__file__).with_name("recorded_sequences.json")
ENCODINGS = ("half-uv", "half", "dilated", "game")
CASES = [(scene, "exact") for scene in SCENES] + [("plaza", encoding) for encoding in ENCODINGS]
QUICK = ("corridor", "exact"), ("plaza", "game")
CHANNELS = ("R", "G", "B", "Z", "motion.x", "motion.y", "mask.dynamic", "mask.disoccluded", "mask.filled_by")
SIZE = "107x60"  # no multiple of a work-group's size


def digests(call, folder, scene, encoding):
    """Return digests of all channels of the rendered frames, and of those extrapolated from them. `call` runs `gffe`
    with arguments."""
    call("render", scene, folder / "in", "--size", SIZE, "--frames", 5, "--ground-truth", "--encode", encoding)
    call("run", folder / "in", folder / "out", "--no-scn", "--ui-detection", "off")
    sequence = open_sequence(folder / "out")
    return tuple(_digest(sequence, entries) for entries in (sequence.rendered, sequence.extrapolated))


def _digest(sequence, entries):
    found = hashlib.sha256()
    for entry in entries:
        names = CHANNELS if entry.kind == "extrapolated" else [n for n in CHANNELS[:6] if not entry.reset or n < "a"]
        for name, values in sorted(sequence.read_channels(entry, names).items()):
            found.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return found.hexdigest()[:16]


@pytest.mark.parametrize(
    ("scene", "encoding"), [pytest.param(*case, marks=[] if case in QUICK else pytest.mark.long) for case in CASES]
)
def test_run_writes_the_recorded_bits(device, gffe, tmp_path, scene, encoding):
    """The ray tracer's bits depend on the runtime's sines, those of the extrapolation on nothing but its input."""

    def call(*arguments):
        code, _, errors = gffe(*arguments, "--device", device.info.index)
        assert code == 0, errors

    rendered, extrapolated = digests(call, tmp_path, scene, encoding)
    recorded = json.loads(RECORD.read_text())[f"{scene} {encoding}"]
    if rendered not in recorded:
        pytest.skip(f"{device.info.name} renders other bits than the recorded ones")
    assert extrapolated == recorded[rendered]


def record():
    found = {}
    for info in (info for info in list_devices() if info.works):
        for scene, encoding in CASES:

            def call(*arguments, index=info.index):
                command = [sys.executable, "-m", "gffe_cl", *map(str, arguments), "--device", index]
                subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

            with tempfile.TemporaryDirectory() as folder:
                rendered, extrapolated = digests(call, Path(folder), scene, encoding)
            found.setdefault(f"{scene} {encoding}", {})[rendered] = extrapolated
            print(info.platform, scene, encoding, rendered, extrapolated, flush=True)
    RECORD.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    record()
