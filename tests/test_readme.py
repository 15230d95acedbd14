"""The README's Python example runs and says what it should."""

import contextlib
import io
import re
from pathlib import Path

README = (Path(__file__).parent.parent / "README.md").read_text()


def test_python_example_runs():
    code = re.search(r"<!-- run by tests/test_readme.py -->\n```python\n(.*?)```", README, re.S)[1]
    assert len(code.strip().splitlines()) <= 13
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "README.md", "exec"), {})
    assert printed.getvalue().split(" ", 1)[1].strip() == "(180, 320, 3) 10.0 0.0"
    assert abs(float(printed.getvalue().split()[0]) - 0.5) < 1e-9


def test_commands_and_options_exist():
    """Every `gffe …` option that the README names is one of the command line's."""
    from typer.main import get_command

    from gffe_cl.cli import app

    commands = get_command(app).commands
    options = {name for command in commands.values() for p in command.params for name in p.opts}
    assert set(re.findall(r"(?<=[`\s])gffe (\w+)", README)) <= set(commands) | {"COMMAND"}
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", README)) - {"--help"} <= options


def test_pictures_exist():
    for path in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README):
        assert (Path(__file__).parent.parent / path).is_file(), path
