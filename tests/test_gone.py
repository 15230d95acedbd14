"""Public names: the stub for type checkers has them all; removed ones give one line that says what to use instead."""

import json
import re
from pathlib import Path

import pytest
from typer.main import get_command

import gffe_cl
from gffe_cl.cli.commands import app, invoke
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.public_names import GONE, HOME


@pytest.mark.parametrize("name", GONE)
def test_a_removed_name_says_what_to_use(name):
    assert GONE[name].endswith((".", ")")) and "\n" not in GONE[name]
    words = name.split()
    with pytest.raises(GffeError, match=f"{name} was removed: "):
        invoke(words[1:]) if words[0] == "gffe" else getattr(gffe_cl, name)


def test_the_stub_has_all_names_and_their_modules():
    """Type checkers read it in place of the module, which loads names on first use."""
    package = Path(gffe_cl.__file__).parent
    stub = (package / "__init__.pyi").read_text()
    names = re.findall(r"^from gffe_cl\.([\w.]+) import (\w+) as \2$", stub, re.M)
    assert {name: module for module, name in names} == HOME and (package / "py.typed").exists()


def public_names():
    """Names of the API, commands, and "gffe command --option"."""
    found = set(gffe_cl.__all__)
    for name, command in get_command(app).commands.items():
        options = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
        found |= {f"gffe {name}", *(f"gffe {name} {option}" for option in options if option.startswith("--"))}
    return found


def test_no_public_name_is_lost_without_a_word():
    """`public_names.json` has every name that was ever public."""
    known, public = json.loads(Path(__file__).with_name("public_names.json").read_text()), public_names()
    assert public <= set(known), "add the new names to tests/public_names.json"
    lost = [name for name in known if name not in public and not {name, " ".join(name.split()[:2])} & set(GONE)]
    assert lost == [], "removed names need a row in gffe_cl/engine/core/public_names.py"


def test_a_removed_name_is_gone():
    assert not set(GONE) & set(gffe_cl.__all__)
    commands = get_command(app).commands
    for name in GONE:
        if name.startswith("gffe "):
            command, *options = name.removeprefix("gffe ").split()
            known = (
                [option for parameter in commands[command].params for option in parameter.opts] if options else commands
            )
            assert (options or [command])[0] not in known
