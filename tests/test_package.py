"""What a program sees of the package: its names, their types, and the functions that serve any image."""

import inspect
import re
from pathlib import Path

import gffe_cl
from gffe_cl.engine.core.public_names import HOME

PACKAGE = Path(gffe_cl.__file__).parent


def test_the_stub_has_all_names_and_their_modules():
    """Type checkers read it in place of the module, which loads names on first use."""
    stub = (PACKAGE / "__init__.pyi").read_text()
    names = re.findall(r"^from gffe_cl\.([\w.]+) import (\w+) as \2$", stub, re.M)
    assert {name: module for module, name in names} == HOME
    assert set(re.findall(r"^(\w+):", stub, re.M)) == {"__version__", "__all__"}
    assert (PACKAGE / "py.typed").exists()


def test_everything_public_is_annotated():
    """Parameters and what is returned, of functions and of public methods of classes."""
    missing = []
    for name in gffe_cl.__all__:
        value = getattr(gffe_cl, name)
        functions = {name: value} if inspect.isfunction(value) else _methods(value) if inspect.isclass(value) else {}
        for called, function in functions.items():
            signature = inspect.signature(inspect.unwrap(function))
            parameters = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
            missing += [f"{name}: {called}({p.name})" for p in parameters if p.annotation is p.empty]
            if called != "__init__" and signature.return_annotation is signature.empty:
                missing.append(f"{name}: {called}() -> …")
    assert not missing


def _methods(kind: type) -> dict:
    """Of its own: those that a program calls."""
    found = {}
    for name, member in vars(kind).items():
        member = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
        if name == "__init__" or not name.startswith("_"):
            found |= {name: member} if inspect.isfunction(member) else {}
    return found


def test_version_is_said_once():
    project = (PACKAGE.parent / "pyproject.toml").read_text()
    assert 'dynamic = ["version",' in project and "gffe_cl.__version__" in project
