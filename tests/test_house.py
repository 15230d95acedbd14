"""The house: a module imports only from floors below its own, and no imports run in a circle. Imports inside functions
and under TYPE_CHECKING count too."""

import ast
from importlib.resources import files
from pathlib import Path

import pytest

from gffe_cl.engine.options import OPTIONS

# Lowest first. A room is a module or a package; rooms on one floor know nothing of each other.
FLOORS = (
    ("core",),
    ("opencl", "frame"),
    ("inference", "sequence"),
    ("stages", "formats", "scenes"),
    ("pipeline", "doctor"),
    ("evaluation", "export"),
    ("scn", "selftest", "viewer"),
    ("cli",),
    ("__main__",),
)
ROOMS_OF_VIEWER = (
    ("viewer.engine",),
    ("viewer.picture",),
    ("viewer.state",),
    ("viewer.panels",),
    ("viewer",),
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
            assert node.level == 0, f"{path}: imports are absolute"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            start, _, inside = name.partition(".")
            if start == "gffe_cl":
                while inside and inside not in known:
                    inside = inside.rpartition(".")[0]
                found.add(inside or "__init__")
    return found - {module}


@pytest.fixture(scope="module")
def graph():
    known = modules()
    assert len(known) > 100 and {"__init__", "viewer.app", "stages.warp", "cli"} <= set(known)
    return {module: imports(module, path, known) for module, path in known.items()}


def floor(module, floors):
    """(number of the floor, room)."""
    for number, rooms in enumerate(floors):
        for room in rooms:
            if module == room or module.startswith(f"{room}."):
                return number, room
    raise AssertionError(f"{module} is on no floor: add it to those of this test and of the documentation")


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


def test_modules_import_only_from_floors_below(graph):
    inside = {module: imported - {"__init__"} for module, imported in graph.items() if module != "__init__"}
    assert upwards(inside, FLOORS) == []
    assert {module for module, imported in graph.items() if "__init__" in imported} <= {
        "cli.commands"
    }  # for the version


def test_rooms_of_the_viewer_import_only_from_floors_below(graph):
    viewer = {
        module: {other for other in imported if other.startswith("viewer")}
        for module, imported in graph.items()
        if module.startswith("viewer")
    }
    assert upwards(viewer, ROOMS_OF_VIEWER) == []


def test_no_circle(graph):
    assert circle(graph) == []


def test_the_rules_can_fail():
    """... or they would hold for any house."""
    graph = {
        "core.errors": {"pipeline.options"},
        "pipeline.options": {"cli.run"},
        "cli.run": {"core.errors"},
        "viewer.app": {"viewer.state.model"},
    }
    assert upwards(graph, FLOORS) == ["core.errors → pipeline.options", "pipeline.options → cli.run"]
    assert circle(graph) == ["cli.run", "core.errors", "pipeline.options"]
    assert upwards({"viewer.engine.story": {"viewer.state.model"}}, ROOMS_OF_VIEWER)
    with pytest.raises(AssertionError, match="on no floor"):
        upwards({"cellar": set()}, FLOORS)


def test_the_viewer_knows_no_option_by_name():
    """A new toggle needs no change in the viewer: only what explains a pixel, what makes shading correction
    unavailable, and what frames are rendered for, read single options."""
    explaining = {
        "engine/explain/pixel_explain.py",
        "engine/explain/fragment_history.py",
        "engine/seeker.py",
        "state/parameters.py",
    }
    folder = parts()["viewer"]
    for path in folder.rglob("*.py"):
        if path.relative_to(folder).as_posix() in explaining:
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Attribute) and node.attr in OPTIONS:
                assert not ast.unparse(node.value).endswith("options"), f"{path}:{node.lineno} reads {node.attr}"
