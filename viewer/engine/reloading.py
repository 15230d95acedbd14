"""Rebuilding kernels whose files change while the viewer runs."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference import network
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import Program, expand, kernel_folder
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import Sizes
from gffe_cl.engine.stages.correction import ShadingCorrection
from gffe_cl.engine.stages.presentation import Composition, Presentation
from gffe_cl.engine.stages.upload import Upload
from .sources.recorded import state_of

WATCH_SECONDS = 0.5  # between looks at the kernels' files


class Kernels(dict):
    """`Device.programs` with the last texts that built. While the files on disk do not build, new pipelines use the
    programs of those texts."""

    def __init__(self, device: Device):
        super().__init__(device.programs)
        self._device, self._texts, self._before = device, {}, device.programs
        self._builds: dict[str, dict[str, str]] = {}  # texts in use since the start, by their identity
        self.identity = ""  # of the newest that build
        self.error: str | None = None
        self.log = ""  # of the compiler, if there is an error
        self.look_again_at, self._files = time.monotonic() + WATCH_SECONDS, _files()
        device.programs = self

    def release(self) -> None:
        self._before.update(self)
        self._device.programs = self._before

    def have_changed(self) -> bool:
        """Return whether files changed since the last call."""
        self.look_again_at = time.monotonic() + WATCH_SECONDS
        before, self._files = self._files, _files()
        return self._files != before

    def reload(self) -> bool:
        """Build all stages from the texts on disk. Returns whether other kernels are in use now. Sets `error`."""
        before = self._texts
        try:
            texts = _texts(kernel_folder())
            if texts == before:
                self.error = None
                return False
            self._texts = texts
            Pipeline(self._device, 1, 1, Options(upscale=1, shading_inputs=True, shading_correction=False))
            board = Board(self._device, Sizes((1, 1), (1, 1)))
            Presentation(board)
            Upload(board)
            Composition(board)
            if network.default_model() or any(key[0] == ShadingCorrection.name for key in self):
                ShadingCorrection(board, load=False)  # the network itself is not needed
        except (GffeError, cl.Error, OSError, ValueError) as error:
            self._texts, self.error, self.log = before, str(error), getattr(error, "log", "") or str(error)
            return False
        self.error = None
        self.identity = self._known(texts)
        return True

    def take(self, folder: Path) -> str:
        """Take over the texts in another folder, which are built when they are used. Returns their identity. Raises
        GffeError. May be called from any thread."""
        texts = _texts(folder)
        if not texts.keys() >= self._texts.keys():
            raise GffeError(f"{folder}: no {min(self._texts.keys() - texts.keys())}.cl (expected a folder of kernels)")
        return self._known(texts)

    def _known(self, texts: dict[str, str]) -> str:
        """Make texts known. Returns their identity."""
        identity = hashlib.sha256(repr(sorted(texts.items())).encode()).hexdigest()[:12]
        self._builds[identity] = texts
        return identity

    @contextmanager
    def used(self, identity: str) -> Iterator[None]:
        """Make pipelines of an older build within the context, of the newest if `identity` is empty. Raises GffeError
        if there is no such build."""
        if identity and identity not in self._builds:
            raise GffeError(f"kernels {identity}: not built since the viewer was started")
        newest, self._texts = self._texts, self._builds.get(identity, self._texts)
        try:
            yield
        finally:
            self._texts = newest

    def __contains__(self, key) -> bool:
        name, text, *variant = key = self._held(key)
        if not super().__contains__(key) and name in self._texts:
            self[key] = Program(self._device, name, text, dict(variant))
        return super().__contains__(key)

    def __getitem__(self, key):
        return super().__getitem__(self._held(key))

    def _held(self, key: tuple) -> tuple:
        return (key[0], self._texts.get(key[0], key[1]), *key[2:])


def _texts(folder: Path) -> dict[str, str]:
    """Return the kernel files in a folder, expanded, by the name of their stage."""
    return {path.stem: expand(path.name, folder) for path in folder.glob("*.cl")}


def _files() -> dict[Path, tuple[int, int] | None]:
    """Return the states of the kernels' files."""
    return {path: state_of(path) for path in kernel_folder().glob("*.[ch]*")}
