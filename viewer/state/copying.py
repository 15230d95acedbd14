"""Copying: a pixel's value, the numbers of a rectangle, and the picture."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection
from ..picture.current_frame import Contents
from ..picture.files import save_png
from ..picture.legends import value_text
from .saving import PictureWork

_PROGRAMS = {"wl-copy": ["--type", "image/png"], "xclip": ["-selection", "clipboard", "-target", "image/png"]}
_PATIENCE = 10.0  # seconds


def value_of(contents: Contents, frame: str, name: str, inspection: Inspection) -> str:
    """Return a line with the value of layer `name` at a pixel of `frame`, and where its content comes from."""
    spec, (x, y) = contents.spec(name), inspection.pixel
    if spec is None or name not in inspection.values:
        return ""
    told = f"{contents.source.name}, {frame}, {spec.group}: {spec.label}, pixel ({x}, {y})"
    told += f": {value_text(spec, inspection.values[name])}"
    if inspection.source is not None and name in inspection.origin:
        right, down = inspection.source
        told += f", from ({right:.2f}, {down:.2f}): {value_text(spec, inspection.origin[name])}"
    return told


def numbers_of(image: np.ndarray, rectangle: tuple[int, int, int, int]) -> str:
    """Return the numbers of an image (H, W, channels?) in a rectangle: a line for each row, a tab between pixels, a
    space between channels."""
    left, top, right, bottom = rectangle
    part = image[top:bottom, left:right]
    part = part.reshape(*part.shape[:2], -1)
    return "\n".join("\t".join(" ".join(f"{value:.7g}" for value in pixel) for pixel in row) for row in part)


class CopyWork(PictureWork):
    """Copying of the picture, as `PictureWork` saves it, to the clipboard."""

    @property
    def label(self) -> str:
        return "→ clipboard"

    def _write(self, pixels: np.ndarray) -> str:
        program = next(filter(shutil.which, _PROGRAMS), None)
        if program is None:
            raise GffeError("pictures are copied by wl-copy or xclip: neither is installed (Ctrl+S saves them)")
        with tempfile.TemporaryDirectory() as folder:
            save_png(path := Path(folder) / "picture.png", pixels)
            with path.open("rb") as picture:  # xclip goes on in the background, and must not hold a pipe
                subprocess.run(
                    [program, *_PROGRAMS[program]], stdin=picture, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                    timeout=_PATIENCE, check=True,
                )  # fmt: skip
        return "copied the picture"
