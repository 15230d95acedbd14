"""Make the pictures and the film of the viewer in docs/pictures. It needs a screen or Xvfb.

    python docs/tools/make_viewer_pictures.py [NAME …]          viewer, story, wrong_pixel, comparing, film

Sequences that are missing in `out/` are rendered first. Scripts of several lines lie beside this file.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from pages import DOCS, PICTURES
from PIL import Image

TOOLS, OUT = DOCS / "tools", Path("out")
COMMAND = [sys.executable, "-m", "gffe_cl"]
SEQUENCES = {  # folder in `out/`, and how it is made
    "walk": ["render", "corridor", "out/walk", "--size", "960x540", "--frames", "16", "--ground-truth"],
    "corridor": ["render", "corridor", "out/corridor", "--size", "480x270", "--frames", "16", "--ground-truth"],
    "bars": ["render", "bars", "out/bars", "--size", "640x360", "--frames", "16", "--ground-truth"],
}


@dataclass(frozen=True)
class Shot:
    """A picture: sequence, size of the window, and a script that ends with its `shot`."""

    sequence: str
    size: str
    script: str


SHOTS = {
    "viewer": Shot(
        "walk",
        "1600x900",
        "seek 15\npixel 300,330\nwith frame.motion\ncompare split\nwait 1\nshot shot.png",
    ),
    "story": Shot("walk", "1600x900", "seek 15\npixel 881,255\nwait 1\nshot shot.png"),
    "wrong_pixel": Shot("bars", "1100x700", "seek 21\npixel 64,186\nwait 1\nshot shot.png"),
    "comparing": Shot("corridor", "1280x720", (TOOLS / "comparing.txt").read_text()),
}


def prepared(sequence: str) -> Path:
    """Return the folder of a sequence, which is made if it is missing."""
    folder = OUT / sequence
    if not (folder / "sequence.json").exists():
        subprocess.run([*COMMAND, *SEQUENCES[sequence]], check=True)
    return folder.resolve()


def view(folder: Path, size: str, script: Path, *more: str) -> None:
    """Run a script in the viewer as a new user has it, in the folder of the script."""
    screen = [] if os.environ.get("DISPLAY") else ["xvfb-run", "-a", "-s", "-screen 0 1920x1200x24"]
    words = [*screen, *COMMAND, "view", str(folder), "--window-size", size, "--script", str(script), *more]
    fresh = os.environ | {"XDG_CONFIG_HOME": str(script.parent / "settings")}
    subprocess.run(words, check=True, cwd=script.parent, env=fresh)


def main() -> None:
    for name in sys.argv[1:] or [*SHOTS, "film"]:
        with tempfile.TemporaryDirectory() as place:
            script = Path(place) / "script.txt"
            if name == "film":
                shutil.copy(TOOLS / "film.txt", script)
                view(prepared("corridor"), "1280x800", script, "--film", str((PICTURES / "viewer.webp").resolve()))
            else:
                shot = SHOTS[name]
                script.write_text(shot.script)
                view(prepared(shot.sequence), shot.size, script)
                (made,) = Path(place).glob("*.png")
                Image.open(made).convert("RGB").save(PICTURES / f"{name}.jpg", quality=82)
        print(name)


if __name__ == "__main__":
    main()
