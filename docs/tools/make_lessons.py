"""Run the commands of the README and of the lessons, in their order, and write their output into the pages.

    python docs/tools/make_lessons.py [PAGE …]       such as tutorial_own_capture; all, if left out

A block without a language is commands. A block `text` after it is the end of the last command's output, as many lines
as it has. A block `python` is saved as engine.py and run; an indented block `text` replaces the lines of its key in
engine.py. `gffe view` takes a screenshot, in a virtual screen if there is none.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

from pages import DOCS, REPOSITORY

PAGES = {
    "README": REPOSITORY / "README.md",
    **{name: DOCS / f"{name}.md" for name in ("tutorial_first_result", "tutorial_wrong_pixel", "tutorial_own_capture")},
}
NOT_RUN = ("git clone", "source ")
SAME = {"make demo": "gffe demo"}  # in an environment that is there
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.S | re.M)
AS_IT_IS = {"drop_whitespace": True, "break_long_words": False, "break_on_hyphens": False, "replace_whitespace": False}
SCREEN = ("xvfb-run", "-a", "-s", "-screen 0 1920x1200x24")


class Lesson:
    """Folder in which commands run, and the output of the last one."""

    def __init__(self, folder: Path):
        self.folder, self.printed = folder, ""

    def run(self, line: str) -> None:
        """Run a line of a block."""
        words = shlex.split(SAME.get(" ".join(shlex.split(line, comments=True)), line), comments=True)
        if not words or line.startswith(NOT_RUN):
            return
        name, words = Path(words[0]).name, words[1:]
        command = [sys.executable, *(["-m", "gffe_cl"] if name == "gffe" else []), *words]
        if words[0] == "view":
            command = [*(() if os.environ.get("DISPLAY") else SCREEN), *command]
            command += [] if "--screenshot" in words else ["--screenshot", "view.png"]
        print(f"{name} {shlex.join(words)}", flush=True)
        environment = os.environ | {"COLUMNS": "120", "XDG_CONFIG_HOME": str(self.folder / "settings")}
        done = subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, text=True)
        if done.returncode not in (0, 1):  # 1: findings
            sys.exit(f"error: {line}: {done.stderr}")
        self.printed = done.stdout

    def edited(self, block: str) -> None:
        """Put the lines of `block` in the place of those with its key in engine.py."""
        script, key = self.folder / "engine.py", block.partition(":")[0]
        script.write_text(
            re.sub(rf"^{re.escape(key)}:.*?\}},\n", lambda _: block, script.read_text(), flags=re.S | re.M)
        )

    def written(self, text: str) -> str:
        """Return the page `text` with the output of its commands."""

        def block(found: re.Match) -> str:
            language, content = found.groups()
            if language == "python":
                (self.folder / "engine.py").write_text(content)
                self.run("python engine.py")
            elif language == "text" and content.startswith(" " * 4):
                self.edited(content)
            elif language == "text":
                lines = [part for line in self.printed.splitlines() for part in textwrap.wrap(line, 120, **AS_IT_IS)]
                return "```text\n" + "\n".join(lines[-content.count("\n") :]) + "\n```"
            elif not language:
                for line in content.splitlines():
                    self.run(line)
            return found[0]

        return BLOCK.sub(block, text)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        lesson = Lesson(Path(name))
        for path in (PAGES[page] for page in sys.argv[1:] or PAGES):
            path.write_text(lesson.written(path.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
