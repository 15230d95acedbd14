"""Source for an attached program: its frames live, or its last frames, frozen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import BadPixels
from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from ..messages import Frame, Key
from .program import RunningProgram
from .recorded import RecordedSource
from .source import FrameSource


class AttachedSource(FrameSource):
    """Live frames of `program`. It has one slot, which is another frame for each number of `flight`; `RemoteSlots`
    makes it."""

    follows = True
    count = 1

    def __init__(self, program: RunningProgram):
        about = program.about
        self.program, self.name, self.fps, self.exposure = program, program.name, about.fps, 1.0
        (self.width, self.height), self.render_size = about.display, about.render_size
        self.options = program.options

    def configure(self, window, n, upscale=0.0):
        return False

    def rendered(self, k):
        raise GffeError(f"{self.name}: a running program shows its frames itself (expected: freeze it)")

    def time(self, k, alpha=0.0):
        return 0.0


class FrozenSource(RecordedSource):
    """The last rendered frames of `program`, taken when this is made; the viewer's own pipeline works on them."""

    def __init__(self, program: RunningProgram, device: Device):
        super().__init__(program.recording(), device)
        self.program, self.name, self.options = program, program.name, program.options
        known, frames = len(self.sequence.known_cameras), self.count
        # frames that the program generated after each rendered one, as far as is known
        self.generated = min(max(round(known / frames), 1), 7)


class RemoteSlots:
    """`SlotMaker` of an `AttachedSource`: the program makes the requested slots.

    `check` is called while the program is waited for, and may raise to give up.
    """

    def __init__(self, source: AttachedSource, check: Callable[[], None]):
        self.source, self._program, self._check = source, source.program, check
        self._chosen: Options | None = None  # by the user, as last asked for
        self._inspected = False  # a pixel of a frame: mostly of generated ones

    def make(self, key: Key, layers: frozenset[str]) -> Frame:
        """Return the program's next frame. Options that have changed since the last call are sent to the program first;
        frames that it makes before it uses them are skipped."""
        chosen, program = key.recipe.setup.options, self._program
        if self._chosen not in (None, chosen) and chosen != resolved(program.options):
            program.use(chosen)
            while True:
                made = self._next(key, layers)
                if resolved(program.options) == chosen:
                    break
        else:
            made = self._next(key, layers)
        self._chosen = chosen
        return made

    def _next(self, key: Key, layers: frozenset[str]) -> Frame:
        specs = self._program.specs
        generated = self._inspected or any(name in specs and specs[name].of_generated for name in layers)
        self._inspected = False
        seen, images = self._program.see(layers, generated, self._check)
        self.source.exposure, self.source.options = seen.exposure, seen.options
        return Frame(
            key,
            layers,
            seen.moment,
            images=images,
            specs=self._program.specs,
            kernels=seen.kernels,
            wall_ms=seen.frame_ms,
            readback_ms=seen.look_ms,
            bad_pixels=seen.bad_pixels or BadPixels(),
            render_size=self.source.render_size,
            buffers=seen.buffers,
        )

    def inspect(self, x: int, y: int) -> Inspection | None:
        """Return the values of the program's next frame at display pixel (x, y); None outside."""
        if not (0 <= x < self.source.width and 0 <= y < self.source.height):
            return None
        self._inspected = True
        return self._program.inspect(x, y, None, self._check)


def resolved(options: Options) -> Options:
    """Return the options with shading correction on or off, not automatic, as the viewer asks for it."""
    return replace(options, shading_correction=options.corrects_shading)
