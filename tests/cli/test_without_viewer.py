"""The packages that only the viewer needs may be missing or broken: everything else works."""

import json
import subprocess
import sys

import tiny_sequence

BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("glfw", "imgui_bundle", "moderngl", "glcontext"):
            raise (OSError if name == "imgui_bundle" else ImportError)(f"{name}\\nis broken")
sys.meta_path.insert(0, Blocked())
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
    "bench": gffe("bench", sequence, "--repeats", "1", "--no-scn"),
    "check": gffe("check", "--help"),
    "view": gffe("view", sequence),
}
unknown = [name for name in gffe_cl.__all__ if not hasattr(gffe_cl, name)]
open(report, "w").write(json.dumps([codes, unknown]))
"""


def test_only_the_viewer_needs_its_packages(tmp_path):
    tiny_sequence.write(tmp_path / "in", frames=5)
    paths = [str(tmp_path / name) for name in ("in", "out", "report.json")]
    done = subprocess.run([sys.executable, "-c", BLOCKED + WORKS, *paths], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    codes, unknown = json.loads((tmp_path / "report.json").read_text())
    assert codes == {"devices": 0, "run": 0, "bench": 0, "check": 0, "view": 2} and not unknown
    assert (tmp_path / "out" / "sequence.json").is_file()
    said = " ".join(done.stderr.split())
    assert "error: the viewer needs imgui-bundle: imgui_bundle is broken (expected: pip install" in said
    assert "Traceback" not in said
