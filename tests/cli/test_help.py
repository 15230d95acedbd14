"""Help texts have one form: a reader understands an option without its name."""

import re

import pytest
from typer.main import get_command

from gffe_cl.cli.commands import app

LONGEST = 160  # characters, with values and default
PRIVATE = r"\b(what|told|tells?|says?|knows?|hangs?|likewise)\b|\bthe same:"
BEGINNINGS = ("Of ", "With ", "And ", "Also ", "The same ", "Which ", "How ")


def faults(text: str, default: object = None) -> list[str]:
    """What breaks the form in a help text."""
    plain = re.sub(r"\[/?dim\]|\[/\]", "", text)
    shown = f"{plain} [default: {default}]" if default not in (None, False, ()) else plain
    found = []
    if not re.match(r"[A-Z]", plain):
        found.append("it starts without a capital")
    if not plain.endswith("."):
        found.append("it ends without a period")
    if len(shown) > LONGEST:
        found.append(f"it has {len(shown)} characters")
    if match := re.search(PRIVATE, plain, re.IGNORECASE):
        found.append(f"it has the word '{match[0]}'")
    if plain.startswith(BEGINNINGS):
        found.append("it does not begin with the thing that is set")
    return found


PARAMETERS = [
    pytest.param(parameter, id=f"{name} {(parameter.opts or [parameter.name])[0]}")
    for name, command in get_command(app).commands.items()
    for parameter in command.params
    if parameter.name != "help"
]


@pytest.mark.parametrize("parameter", PARAMETERS)
def test_help_has_the_form(parameter):
    assert faults(parameter.help or "", parameter.default) == []


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "capital"),
        ("frame size.", "capital"),
        ("Frame size", "period"),
        ("Frame size, " + "pixels, " * 20 + "each way.", "characters"),
        ("Colors that show what is hidden.", "'what'"),
        ("Cuts that nobody told of.", "'told'"),
        ("Of a built-in scene: frames.", "begin"),
    ],
)
def test_faults_are_found(text, fault):
    assert any(fault in one for one in faults(text))


def test_the_default_counts():
    assert faults("A" * 150 + ".") == [] and faults("A" * 150 + ".", "1920x1080")
