"""The README's Python example runs and says what it should."""

import contextlib
import io
import re
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text()


EXAMPLES = re.findall(r"<!-- run by tests/test_readme.py -->\n```python\n(.*?)```", README, re.S)


@pytest.mark.parametrize(
    ("index", "expected"),
    [
        (0, "-1.00 1.08 False (180, 320, 3)"),
        (1, "['frame_000000.exr', 'frame_000001.exr', 'frame_000002.exr']"),
        (2, "0.5 (180, 320, 3) 10.0 0.0"),
    ],
)
def test_python_examples_run(index, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert len(EXAMPLES) == 3 and len(EXAMPLES[index].strip().splitlines()) <= 16
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(EXAMPLES[index], "README.md", "exec"), {})
    assert re.sub(r"0\.(5|49)0*\d*\b", "0.5", printed.getvalue().strip()) == expected


def test_commands_and_options_exist():
    """Every `gffe …` option that the README names is one of the command line's."""
    from typer.main import get_command

    from gffe_cl.cli import app

    others = {"--logdir", "--nproc-per-node"}  # of other programs
    commands = get_command(app).commands
    options = {name for command in commands.values() for p in command.params for name in (*p.opts, *p.secondary_opts)}
    assert set(re.findall(r"(?<=[`\s])gffe (\w+)", README)) <= set(commands) | {"COMMAND"}
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", README)) - {"--help", *others} <= options


def test_pictures_exist():
    for path in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README):
        assert (Path(__file__).parent.parent / path).is_file(), path
