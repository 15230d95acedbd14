"""The packages that only the viewer, the lab or videos need may be missing or broken: everything else works."""

import json
import re
import subprocess
import sys

import pytest
import tiny_sequence

BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("glfw", "imgui_bundle", "moderngl", "glcontext"):
            raise (OSError if name == "imgui_bundle" else ImportError)(f"{name}\\nis broken")
sys.meta_path.insert(0, Blocked())
sys.modules.update(dict.fromkeys(("skimage", "scipy", "flip_evaluator", "imageio_ffmpeg")))  # as if not installed
from gffe_cl.cli import main
from gffe_cl.engine.timing import bench
bench._COPY_BYTES = 1 << 20
def gffe(*arguments):
    sys.argv = ["gffe", *arguments]
    try:
        main()
    except SystemExit as stop:
        return stop.code or 0
    return 0
"""
WORKS = """
import json
import gffe_cl
sequence, out, report = sys.argv[1:]
codes = {
    "devices": gffe("devices"),
    "run": gffe("run", sequence, out, "--no-check", "--no-scn"),
    "bench": gffe("bench", "--sizes", "96x54", "--repeats", "1", "--no-scn"),
    "check": gffe("check", "--help"),
    "view": gffe("view", sequence),
    "page": gffe("view", sequence, "--no-scn", "--export", out + "/page"),
    "eval": gffe("eval", sequence),
    "demo": gffe("demo"),
}
unknown = [name for name in gffe_cl.__all__ if not hasattr(gffe_cl, name)]
open(report, "w").write(json.dumps([codes, unknown]))
"""


@pytest.mark.long
def test_only_those_who_need_packages_ask_for_them(tmp_path):
    tiny_sequence.write(tmp_path / "in", frames=5)
    paths = [str(tmp_path / name) for name in ("in", "out", "report.json")]
    done = subprocess.run([sys.executable, "-c", BLOCKED + WORKS, *paths], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    codes, unknown = json.loads((tmp_path / "report.json").read_text())
    assert codes == {"devices": 0, "run": 0, "bench": 0, "check": 0, "view": 2, "page": 0, "eval": 2, "demo": 2}
    assert not unknown
    assert (tmp_path / "out" / "sequence.json").is_file()
    said = " ".join(done.stderr.split())
    assert "error: the viewer needs imgui-bundle: imgui_bundle is broken (expected: pip install" in said
    for what, extra in (("eval", "lab"), ("demo", "lab,video")):
        assert re.search(rf"error: {what} needs \w+: pip install '\.\[{extra}\]'", said)
    assert "Traceback" not in said
