"""Measurement of time and quality of methods on the same frames, in turns (`gffe bench --methods`).

Every method is timed as it would run live, from the buffers of a rendered frame to the color of the new one. Pipelines
and `dilate-splat` take and leave buffers of their device: no copy to or from the host is inside, but for those around
the shading correction network. Methods of OpenCV and PyTorch take and leave float32 arrays in host memory: the
conversion of 16-bit colors is not inside, that to the 8-bit gray of optical flow is.
"""

from __future__ import annotations

import datetime
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import islice, product
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import PRESETS, Options
from gffe_cl.engine.timing.footage import uploaded
from gffe_cl.lab.bench.counting import SIZE
from gffe_cl.lab.bench.footage import SCENE, SCENE_FPS, SCENE_FRAME, is_sequence
from gffe_cl.lab.compare import NO_HISTORY
from gffe_cl.lab.metrics import METRICS, RegionErrors, to_display
from gffe_cl.lab.metrics.regions import REGIONS, masks
from gffe_cl.lab.table.datasets import Footage, Moment, Shot, Subject, open_subject, parse_subject
from gffe_cl.lab.table.labels import find_labels
from gffe_cl.lab.table.methods import DILATE_SPLAT, FULL, LIBRARY, METHODS, Method, chosen_methods
from gffe_cl.lab.table.results import versions

WITHOUT_NETWORK = "no-scn"
OTHER_PRESETS = {name: preset.values for name, preset in PRESETS.items() if preset.values}
MOMENTS = 6  # new frames whose quality is measured, and which are timed again and again
_REST = 0.02  # seconds before each turn, in which the threads of the method before come to rest

OpenStep = Callable[[str, int], Callable[[], None]]  # description, number of parts → function to call after each


class TimedClip(Footage):
    """The first rendered frames of `footage`, up to the one after which `moments` new ones have been made: one after
    each that has any, the one nearest to the middle of the interval. Colors are float32."""

    def __init__(self, footage: Footage, moments: int, on_shot: Callable[[], None] = lambda: None):
        super().__init__(footage.name, footage.width, footage.height, footage.fps, footage.exposure)
        self.exact, self._shots, found = footage.exact, [], 0
        for shot in footage.shots():
            chosen = sorted(shot.moments, key=lambda moment: abs(moment.alpha - 0.5))[:1]
            shown = np.ascontiguousarray(shot.shown, np.float32)
            frame = replace(shot.frame, reset=shot.frame.reset or not self._shots)
            self._shots.append(replace(shot, frame=frame, shown=shown, moments=tuple(chosen), following=None))
            on_shot()
            found += len(chosen)
            if found == moments:
                break

    def _make(self, window):
        yield from self._shots


def subject_of(text: str | None, size: tuple[int, int] | None, frame: int | None) -> Subject:
    """Return the subject of `gffe bench` as `gffe eval` takes it: `MOMENTS` new frames of a scene, the first one after
    rendered frame `frame`, or a sequence with ground truth, from its start. Raises GffeError."""
    if is_sequence(text):
        if size or frame is not None:
            raise GffeError("--methods takes a sequence from its start, at its own size: leave out --frame and --sizes")
        return parse_subject(str(text), SIZE, MOMENTS, SCENE_FPS, (0.5,))
    frame = SCENE_FRAME if frame is None else frame
    if frame < NO_HISTORY:
        raise GffeError(f"--frame must be at least {NO_HISTORY} with --methods, got {frame}")
    subject = parse_subject(text or SCENE, size or SIZE, NO_HISTORY + MOMENTS, SCENE_FPS, (0.5,))
    return replace(subject, start=frame - NO_HISTORY)


@dataclass
class Contestant:
    """A method at work: `device` and frames in its buffers where it works on one. `milliseconds` of each timed turn,
    `errors` of the new frames by region."""

    method: Method
    device: Device | None
    runner: Any  # a DeviceRunner on a device, else a Runner
    frames: list
    milliseconds: list[float] = field(default_factory=list)
    errors: RegionErrors = field(default_factory=RegionErrors)

    def turn(self, number: int, shot: Shot) -> tuple[float, object]:
        """Take rendered frame `number` of the clip and make the new frame after it, if there is one. Return
        milliseconds and the frame."""
        time.sleep(_REST)
        shot, made = replace(shot, frame=self.frames[number]), None
        start = time.perf_counter()
        self.runner.submit(shot)
        for moment in shot.moments:
            made = self._made(moment)
        if self.device:
            self.device.queue.finish()
        return 1e3 * (time.perf_counter() - start), made

    def color(self, made) -> np.ndarray:
        """Return (H, W, 3) linear color of the result of `turn`."""
        return self.runner.color_of(made) if self.device else made

    def _made(self, moment: Moment):
        return self.runner.extrapolated(moment) if self.device else self.runner.make(moment)


def measure_methods(subject: Subject, devices: list[Device], options: Options, repeats: int, step: OpenStep) -> dict:
    """Return the figures for one subject, as JSON: see `_report`. Pipelines, with and without the network, and
    `DILATE_SPLAT` run on all `devices`; ratios are to the first method on the first one. `options`: of the pipelines.
    `repeats`: timed turns."""
    if options.upscale:
        raise GffeError("--methods takes frames of the display's size, not --upscale's")
    advance = step(f"{subject.name}: frames and ground truth", NO_HISTORY + min(subject.moments, MOMENTS))
    clip = TimedClip(open_subject(subject, devices[0]), MOMENTS, advance)
    moments = sum(len(shot.moments) for shot in clip.shots())
    advance = step(f"{clip.name}: regions", moments)
    clip.labels = [labels for labels in find_labels(clip, devices[0]) if advance() is None]
    contestants, skipped = _contestants(clip, devices, options)
    rounds = 1 + -(-repeats // moments)
    total = rounds * len(list(clip.shots())) * len(contestants)
    _play(clip, contestants, rounds, step(f"{clip.name}, {clip.width}×{clip.height}: turns", total))
    return _report(clip, contestants, skipped)


def _play(clip: TimedClip, contestants: list[Contestant], rounds: int, advance: Callable[[], None]) -> None:
    """Play the clip so many times: quality is measured in the first round, time in the others. In each turn another
    method begins."""
    for turn, (playing, (number, shot)) in enumerate(product(range(rounds), enumerate(clip.shots()))):
        for k in range(len(contestants)):
            one = contestants[(turn + k) % len(contestants)]
            milliseconds, made = one.turn(number, shot)
            if shot.moments and playing:
                one.milliseconds.append(milliseconds)
            elif shot.moments:
                shown, truth = (to_display(c, clip.exposure) for c in (one.color(made), shot.moments[0].truth))
                moment = sum(len(before.moments) for before in islice(clip.shots(), number))
                one.errors.add(shown, truth, masks(clip.labels[moment]), [METRICS["psnr"]])
            advance()


def _contestants(clip: TimedClip, devices: list[Device], options: Options) -> tuple[list[Contestant], dict[str, str]]:
    """Return all contestants, and the reasons why methods are left out, by name."""
    changes = {FULL: {}, WITHOUT_NETWORK: {"shading_correction": False}, **OTHER_PRESETS}
    if not options.corrects_shading:
        del changes[WITHOUT_NETWORK]
    found = []
    for device in devices:
        frames = [uploaded(device, shot.frame) for shot in clip.shots()]
        for method in (METHODS[name] for name in (*changes, DILATE_SPLAT)):
            if method.options is not None:
                method = replace(method, options=replace(options, **changes[method.name]))
            found.append(Contestant(method, device, method.runner(clip, device), frames))
    others = chosen_methods(["repeat", LIBRARY])
    skipped = {name: reason for name, method in others.items() if (reason := method.missing(clip))}
    host = [shot.frame for shot in clip.shots()]
    found += [Contestant(m, None, m.runner(clip, devices[0]), host) for n, m in others.items() if n not in skipped]
    return found, skipped


def _report(clip: TimedClip, contestants: list[Contestant], skipped: dict[str, str]) -> dict:
    """Return the `share` of the pixels by region; and by method the medians of milliseconds and of the ratios of its
    time to the first method's within a turn, PSNR in dB of all pixels together (not a mean of frames), and PSNR by
    region."""
    first = contestants[0]
    rows = []
    for one in contestants:
        ratios = [a / b for a, b in zip(one.milliseconds, first.milliseconds, strict=True)]
        psnr = {region: one.errors.figure("psnr", region) for region in ("whole", *REGIONS)}
        rows.append(
            {
                "method": one.method.name,
                "title": one.method.title,
                "device": one.device and one.device.info.name,
                "platform": one.device and one.device.info.platform,
                "milliseconds": round(statistics.median(one.milliseconds), 3),
                "ratio": round(statistics.median(ratios), 4),
                "psnr": round(psnr.pop("whole"), 3),
                "regions": {region: round(value, 3) for region, value in psnr.items()},
            }
        )
    return {
        "of": clip.name,
        "width": clip.width,
        "height": clip.height,
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
        "versions": versions(),
        "turns": len(first.milliseconds),
        "share": {region: round(first.errors.share(region), 5) for region in REGIONS},
        "methods": rows,
        "skipped": skipped,
    }
