"""The house: wings of the package, and floors inside them. A module imports only from wings that its own may know and
from floors below its own; no imports run in a circle. Imports inside functions and under TYPE_CHECKING count, too."""

import ast
import json
import re
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

from gffe_cl.engine.opencl.program import kernel_folder

# What a module of each wing may import beyond its own wing.
WINGS = {
    "engine": (),
    "captures": ("engine",),
    "lab": ("engine", "captures"),
    "viewer": ("engine", "captures", "lab.metrics"),
    "cli": ("engine", "captures", "lab", "viewer"),
    "__main__": ("cli",),
}
# Lowest first. A room is a module or a package; rooms on one floor know nothing of each other.
FLOORS = {
    "engine": (
        ("core",),
        ("opencl", "frame"),
        ("inference",),
        ("options",),
        ("stages",),
        ("upscaling",),
        ("pipeline",),
        ("timing", "export", "inspection"),
        ("selftest",),
    ),
    "captures": (
        ("sequence", "video"),
        ("formats", "scenes"),
        ("offline", "doctor"),
    ),
    "lab": (
        ("metrics", "cluster"),
        ("compare",),
        ("table", "training", "demo"),
        ("bench",),
    ),
}
ROOMS_OF_VIEWER = (
    ("viewer.engine",),
    ("viewer.picture",),
    ("viewer.state",),
    ("viewer.window",),
)


def parts():
    """Folders of sources by the names of their packages, without "gffe_cl."."""
    package = Path(str(files("gffe_cl")))
    return {"": package, "viewer": Path(str(files("gffe_cl.viewer")))}


def modules():
    """Path by module name, without "gffe_cl."."""
    found = {}
    for name, folder in parts().items():
        for path in sorted(folder.rglob("*.py")):
            place = (*filter(None, [name]), *path.relative_to(folder).with_suffix("").parts)
            found[".".join(place[:-1] if place[-1] == "__init__" and len(place) > 1 else place)] = path
    return found


def imports(module, path, known):
    """Names of the package's modules that a module imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            target = absolute(module, path, node)
            names = [f"{target}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            start, _, inside = name.partition(".")
            if start == "gffe_cl":
                while inside and inside not in known:
                    inside = inside.rpartition(".")[0]
                found.add(inside or "__init__")
    return found - {module}


def absolute(module, path, node):
    """What "from … import" imports from. The viewer's modules import each other relatively, or tools would look for
    them in gffe_cl/, where they are only when installed; all other imports are absolute."""
    if node.level == 0:
        assert not (module.startswith("viewer.") and f"{node.module}.".startswith("gffe_cl.viewer.")), (
            f"{path}: relative"
        )
        return node.module
    assert module.startswith("viewer."), f"{path}: imports are absolute"
    levels = node.level - (path.name == "__init__.py")
    return ".".join(["gffe_cl", *module.split(".")[: -levels or None], *filter(None, [node.module])])


# Lines that a wing may have. A change that removes lines lowers its number; one that adds lines removes others.
LEDGER = {
    "gffe_cl": 38_163,
    "viewer": 12_678,
    "kernels": 10_783,
    "tests": 29_047,
    "docs/tools": 4_389,
    "docs/examples": 1_884,
    "docs/*.md": 4_493,
}
MOST_MODULES = 204
_CODE = {".py", ".pyi", ".c", ".h", ".cl", ".js", ".frag", ".vert", ".cpp"}


def lines_of(wing):
    """Lines of the code in a folder, or of the files that a pattern finds."""
    root = Path(__file__).parents[1]
    found = root.glob(wing) if "*" in wing else (f for f in (root / wing).rglob("*") if f.suffix in _CODE)
    return sum(path.read_bytes().count(b"\n") for path in found)


@pytest.mark.parametrize("wing", LEDGER)
def test_no_wing_grows(wing):
    assert 0 < lines_of(wing) <= LEDGER[wing], f"{wing}: what is added names the lines that go (CONTRIBUTING.md)"


def test_no_more_modules():
    assert len(modules()) <= MOST_MODULES


@pytest.fixture(scope="module")
def graph():
    known = modules()
    assert len(known) > 100 and {"__init__", "viewer.window.app", "engine.stages.warp", "cli"} <= set(known)
    return {module: imports(module, path, known) for module, path in known.items()}


def floor(module, floors):
    """(number of the floor, room)."""
    for number, rooms in enumerate(floors):
        for room in rooms:
            if module == room or module.startswith(f"{room}."):
                return number, room
    raise AssertionError(f"{module} is on no floor: add it to those of this test and of the documentation")


def wing_of(module):
    return module.partition(".")[0]


def across(graph, wings):
    """Imports from wings that the module's own may not know."""
    return sorted(
        f"{module} → {other}"
        for module, imported in graph.items()
        for other in imported
        if wing_of(other) != wing_of(module)
        and not any(f"{other}.".startswith(f"{known}.") for known in wings[wing_of(module)])
    )


def inside(graph, wing):
    """The part of the graph within a wing, by names without it; not the wing's `__init__`."""
    return {
        module.removeprefix(f"{wing}."): {
            other.removeprefix(f"{wing}.") for other in imported if other.startswith(f"{wing}.")
        }
        for module, imported in graph.items()
        if module.startswith(f"{wing}.")
    }


def upwards(graph, floors):
    """Imports from the same floor, but for the same room, or from above."""
    found = []
    for module, imported in graph.items():
        number, room = floor(module, floors)
        for other in imported:
            above, its_room = floor(other, floors)
            if its_room != room and above >= number:
                found.append(f"{module} → {other}")
    return sorted(found)


def circle(graph):
    """Modules that import each other in a circle; empty if there are none."""
    done, path = set(), []

    def visit(module):
        if module in path:
            return path[path.index(module) :]
        if module in done:
            return []
        path.append(module)
        found = next(filter(None, map(visit, sorted(graph.get(module, ())))), [])
        path.pop()
        done.add(module)
        return found

    return next(filter(None, map(visit, sorted(graph))), [])


def test_wings_import_only_from_those_they_may_know(graph):
    known = {module: imported for module, imported in graph.items() if module != "__init__"}
    assert across(known, WINGS) == []
    assert graph["__init__"] == {"engine.core.public_names"}
    assert not [module for module, imported in graph.items() if "__init__" in imported]


@pytest.mark.parametrize("wing", FLOORS)
def test_modules_import_only_from_floors_below(graph, wing):
    assert upwards(inside(graph, wing), FLOORS[wing]) == []


def test_rooms_of_the_viewer_import_only_from_floors_below(graph):
    viewer = {
        module: {other for other in imported if other.startswith("viewer")}
        for module, imported in graph.items()
        if module.startswith("viewer.")
    }
    assert sum(map(len, viewer.values())) > 200  # the relative imports are found
    assert upwards(viewer, ROOMS_OF_VIEWER) == []


def test_no_circle(graph):
    assert circle(graph) == []


def test_the_rules_can_fail():
    """... or they would hold for any house."""
    graph = {
        "engine.core.errors": {"engine.pipeline.pipeline"},
        "engine.pipeline.pipeline": {"captures.formats"},
        "captures.formats": {"engine.core.errors"},
        "viewer.window.app": {"viewer.state.model", "lab.table.cells", "lab.metrics"},
    }
    assert across(graph, WINGS) == [
        "engine.pipeline.pipeline → captures.formats",
        "viewer.window.app → lab.table.cells",
    ]
    assert upwards(inside(graph, "engine"), FLOORS["engine"]) == ["core.errors → pipeline.pipeline"]
    assert circle(graph) == ["captures.formats", "engine.core.errors", "engine.pipeline.pipeline"]
    assert upwards({"viewer.engine.story": {"viewer.state.model"}}, ROOMS_OF_VIEWER)
    assert upwards({"viewer.state.model": {"viewer.window.app"}}, ROOMS_OF_VIEWER)
    with pytest.raises(AssertionError, match="on no floor"):
        upwards({"cellar": set()}, FLOORS["engine"])


def test_imports_of_the_viewer_are_relative(tmp_path):
    """... and of all others absolute: each fails where it is the other way round."""
    path, known = tmp_path / "plot.py", {"viewer", "viewer.state", "viewer.state.model", "engine.stages.warp"}
    path.write_text("from ..state import model\nfrom gffe_cl.engine.stages import warp\nfrom . import widgets\n")
    assert imports("viewer.window.plot", path, known) == {"viewer.state.model", "engine.stages.warp", "viewer"}
    with pytest.raises(AssertionError, match="absolute"):
        imports("engine.stages.plot", path, known)
    path.write_text("from gffe_cl.viewer.state import model\n")
    assert imports("cli.view", path, known) == {"viewer.state.model"}
    with pytest.raises(AssertionError, match="relative"):
        imports("viewer.window.plot", path, known)


_PIPELINE = """
import json, sys
import numpy as np
import gffe_cl
before = set(sys.modules)
import pyopencl as cl
device = gffe_cl.open_device()
def buffer(*shape):
    array = np.ones(shape, np.float16 if shape[-1] == 4 else np.float32)
    return cl.Buffer(device.context, cl.mem_flags.COPY_HOST_PTR, hostbuf=array)
pipeline = gffe_cl.Pipeline(device, 32, 24, gffe_cl.Options(shading_correction=False))
camera = gffe_cl.Camera(np.eye(4), 32.0, 32.0, 16.0, 12.0)
for k in range(2):
    frame = gffe_cl.RenderedFrame(buffer(24, 32, 4), buffer(24, 32), buffer(24, 32, 2), camera, k / 30)
    pipeline.submit(frame)
    made = pipeline.extrapolate(camera, k / 30 + 1 / 60)
assert made.numpy("color").shape == (24, 32, 3)
print(json.dumps(sorted(sys.modules)))
"""
# Of a renderer's process, beside the standard library and the engine wing: the rest is what NumPy and pyopencl load.
_LINKED = {"numpy", "pyopencl", "platformdirs", "pytools", "siphash24", "typing_extensions", "mako", "cython_runtime"}


def test_a_renderer_links_the_engine_alone():
    """A pipeline on device buffers loads NumPy, pyopencl with what that needs, platformdirs, and nothing
    of the package but the engine wing."""
    done = subprocess.run([sys.executable, "-c", _PIPELINE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    loaded = json.loads(done.stdout)
    ours = {name for name in loaded if name.startswith("gffe_cl.")}
    assert {name for name in ours if wing_of(name.removeprefix("gffe_cl.")) not in ("engine", "kernels")} == set()
    tops = {name.partition(".")[0] for name in loaded} - set(sys.stdlib_module_names) - {"gffe_cl", "__main__"}
    assert {name for name in tops if not name.startswith("_")} <= _LINKED


def test_the_map_has_the_wings_of_the_house():
    page = (Path(__file__).parents[1] / "docs/map.md").read_text("utf-8")
    for wing, floors in FLOORS.items():
        (row,) = re.findall(rf"^\| `gffe_cl/{wing}/` \|.*\| (.*) \|$", page, re.M)
        rooms = [room for rooms in floors for room in rooms]
        assert [name for name in re.findall(r"`(\w+)`", row) if name in rooms] == rooms


def test_a_constant_of_kernels_has_one_value():
    """Files that need one threshold share it (kernels/thresholds.h); other thresholds have other names."""
    assert several_values({"a.cl": "#define FAR 0.5f /* px */", "b.h": "#define FAR 0.25f"}) == {"FAR"}
    folder = kernel_folder()
    files = {str(path): path.read_text() for path in folder.rglob("*") if path.suffix in (".cl", ".h")}
    assert several_values(files) == set()


def several_values(files):
    """Names that are defined in several of these texts, by file, not alike."""
    found = {}
    for file, text in files.items():
        text = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        for name, value in re.findall(r"^[ \t]*#define (\w+)[ \t]+([^\n\\]+)$", text, re.M):
            found.setdefault(name, {}).setdefault(file, set()).add(value.strip())
    return {name for name, by_file in found.items() if len(set(map(frozenset, by_file.values()))) > 1}
