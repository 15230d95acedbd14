"""Choice of options for real time: measured on the device, the best that fit into a budget."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_kind, require_list, require_size, require_whole, require_within
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, checked_frame, host_arrays
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import PRESETS, Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.memory_budget import NoRoomError
from gffe_cl.engine.timing.footage import SETTLED, FrameLoop

# The best first.
LADDER = {
    "quality": PRESETS["quality"].values,
    "balanced": PRESETS["balanced"].values,
    "balanced without the network": {"shading_correction": False},
    "performance": PRESETS["performance"].values,
}
BUDGETS = (1e-3, 1e5)  # ms
_MOST_REPEATS = 10000


@dataclass(frozen=True)
class Choice:
    """Options that were chosen, and why.

    Attributes
    ----------
    options : Options
        The best that fit into the budget. Where none do, they are the quickest.
    name : str
        Name of these options.
    fits : bool
        Whether they fit into the budget.
    budget_ms : float
        The budget, milliseconds.
    milliseconds : dict
        Time of all options that were measured, by name, the best first.
    too_large : tuple of str
        Names of the options that need more memory than the device has.
    """

    options: Options
    name: str
    fits: bool
    budget_ms: float
    milliseconds: dict[str, float]
    too_large: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The name of the options, their time, and why no others were chosen."""
        relation = "fits into" if self.fits else "takes the least, but does not fit into"
        words = [f"{self.name}: {self.milliseconds[self.name]:.2f} ms {relation} {self.budget_ms:g} ms"]
        for name, taken in reversed(self.milliseconds.items()):
            if name != self.name:
                words.append(f"{name} takes {taken:.2f} ms")
        words += [f"{name} needs more memory than the device has" for name in reversed(self.too_large)]
        return "; ".join(words)


def choose_options(
    device: Device,
    frames: Sequence[RenderedFrame],
    budget_ms: float,
    options: Options | None = None,
    repeats: int = 9,
    size: tuple[int, int] | None = None,
) -> Choice:
    """Measure presets on `device` with rendered frames of your program, and return the best that fits.

    Where none fits into the budget, it is the quickest. Those that need more memory than the device has are passed
    over. The cost is that of one rendered and one new frame, by the clock, from `Pipeline.submit` until the new frame
    is there: the median of `repeats`. It depends on the picture, so take frames of a scene that is hard.

    Parameters
    ----------
    device : Device
        Nothing else should use it meanwhile.
    frames : sequence of RenderedFrame
        Three or more of NumPy arrays, one after another, of the size that you will use.
    budget_ms : float
        Milliseconds, 0.001 to 100000.
    options : Options
        Values of all options that no preset sets.
    repeats : int
        Number of timed pairs for each preset, 1 to 10000.
    size : (width, height) or None
        Size of the display, pixels; that of the frames' color if None.

    Raises
    ------
    GffeError
        For fewer than three frames, times that do not increase, invalid frames, and values out of range; and where no
        preset fits into the device's memory.
    """
    require_kind(device, Device, "choose_options: device", "an open Device")
    given = Options() if options is None else require_kind(options, Options, "choose_options: options")
    count = require_whole(repeats, "choose_options: repeats", 1, _MOST_REPEATS)
    listed = require_list(frames, RenderedFrame, "choose_options: frames", "a list of RenderedFrame")
    listed = [checked_frame(frame) for frame in listed]
    if len(listed) <= SETTLED:
        raise GffeError(f"choose_options: frames must be at least {SETTLED + 1}, got {len(listed)}")
    height, width = host_arrays(listed[0]).color.shape[:2]
    shown = (width, height) if size is None else require_size(size, "choose_options: size", whole=True)
    interval = listed[1].time - listed[0].time
    if not all(b.time > a.time for a, b in pairwise(listed)):
        raise GffeError("choose_options: times of frames must increase")
    cameras = (None,) * len(listed)
    loop = FrameLoop("", *shown, 1.0, interval, tuple(listed), cameras, forward=True, render_size=(width, height))
    return choose_for(device, loop, budget_ms, given, count)


def choose_for(device: Device, loop: FrameLoop, budget_ms: float, options: Options, repeats: int) -> Choice:
    """Return the same for a loop of frames."""
    budget = require_within(budget_ms, "budget_ms", *BUDGETS)
    loop, tried, taken, too_large, refused = loop.on(device), {}, {}, [], None
    usual = {option: getattr(Options(), option) for values in LADDER.values() for option in values}
    usual["shading_correction"] = options.shading_correction
    for name, values in LADDER.items():
        if name == "balanced without the network" and not options.corrects_shading:
            continue  # so is the rung above
        tried[name] = replace(options, **usual | values)
        try:
            taken[name] = _milliseconds(device, loop, tried[name], repeats)
        except NoRoomError as error:
            too_large.append(name)
            refused = error
        else:
            if taken[name] <= budget:
                break
    if refused and not taken:
        raise refused
    name = min(taken, key=taken.__getitem__)
    return Choice(tried[name], name, taken[name] <= budget, budget, taken, tuple(too_large))


def _milliseconds(device: Device, loop: FrameLoop, options: Options, repeats: int) -> float:
    """Return the median time of a pair."""
    pipeline, walls = Pipeline(device, loop.width, loop.height, options, render_size=loop.render_size), []
    pipeline.exposure = loop.exposure
    for turn in loop.turns(repeats):
        device.queue.finish()
        start = time.perf_counter()
        pipeline.submit(turn.frame)
        made = pipeline.extrapolate(turn.camera, turn.time(loop.interval))
        assert made.color  # waits for a network on the host
        device.queue.finish()
        walls += [1e3 * (time.perf_counter() - start)] * turn.counts
    return statistics.median(walls)
