"""Removed names of the API, commands and options give one line that says what to use instead."""

import pytest
from typer.main import get_command

import gffe_cl
from gffe_cl.cli.commands import app, invoke
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.gone import GONE


@pytest.mark.parametrize("name", GONE)
def test_a_removed_name_says_what_to_use(name):
    assert GONE[name].endswith((".", ")")) and "\n" not in GONE[name]
    words = name.split()
    with pytest.raises(GffeError, match=f"{name} was removed: "):
        invoke(words[1:]) if words[0] == "gffe" else getattr(gffe_cl, name)


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
