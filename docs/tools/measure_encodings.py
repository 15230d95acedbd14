"""Measure the automatic static threshold with buffers as engines and captures keep them.

    python docs/tools/measure_encodings.py                    prints the table of docs/deviations.md; two minutes a seed
    python docs/tools/measure_encodings.py --write            puts it there, and all figures into measured/
    python docs/tools/measure_encodings.py --seeds 2 --grid   also a line for each scene

Each built-in scene is rendered once at 480×270. Then it is stored by every encoding of `gffe render --encode`, with the
steps of a 1920×1080 image. New frames at t + ½ are made with the automatic threshold and with fixed ones, without the
network. Measured are PSNR of display values over all frames of a scene, and the share of dynamic pixels.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pages import MEASURED, table, write_tables

from gffe_cl.captures.scenes import SCENES, SceneFrames, SceneRenderer, load_scene
from gffe_cl.captures.sequence.encoding import EXACT, Encoding
from gffe_cl.captures.sequence.engine_form import static_motion
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.compare import NO_HISTORY
from gffe_cl.lab.metrics import decibels, squared_error, to_display

ALPHA, FPS = 0.5, 30.0
SIZE, FRAMES = (480, 270), 8
LEAST = 0.25  # pixels: the least automatic threshold
FIXED = (1.0, 1.4, 2.0, 2.8, 4.0)  # pixels
ENCODINGS = "", "half-uv", "unorm8", "half-depth"
BELOW, FACTOR = 0.2, 1.5  # targets: dB below the best fixed threshold, and factor of the share of dynamic pixels
RECORD = MEASURED / "encodings.json"


@dataclass
class Moment:
    """A rendered frame, and what is to be shown at t + α."""

    frame: RenderedFrame
    time: float
    camera: Camera
    truth: np.ndarray


@dataclass(frozen=True)
class Cell:
    """Figures of one scene and encoding. `psnr`: dB by threshold, "automatic" or pixels; `dynamic`, `exact`: shares of
    dynamic pixels by the automatic one, encoded and exact; `visible`: see `visible`; `loss`: dB by which the encoding
    is below exact buffers."""

    scene: str
    seed: int
    encoding: str
    psnr: dict[str, float]
    dynamic: float
    exact: float
    visible: float
    loss: float

    @property
    def gain(self) -> float:
        """Advantage of the automatic threshold over the best fixed one, dB."""
        return self.psnr["automatic"] - max(value for name, value in self.psnr.items() if name != "automatic")

    @property
    def factor(self) -> float:
        """Ratio of the shares of dynamic pixels."""
        return self.dynamic / self.exact

    def is_close_to(self, share: float) -> bool:
        """Return whether the share of dynamic pixels is as near to `share` as is aimed at."""
        return 1 / FACTOR <= self.dynamic / max(share, 1e-9) <= FACTOR


def render(device: Device, name: str, seed: int) -> tuple[float, list[Moment]]:
    """Return exposure and moments of a scene."""
    scene = load_scene(name, seed)
    frames, moments = SceneFrames(SceneRenderer(device, scene, *SIZE)), []
    for frame in frames.sequence(FRAMES, FPS):
        time = frame.time + ALPHA / FPS
        truth = to_display(frames.truth(time).read("color"), scene.exposure)
        moments.append(Moment(frame, time, frames.display_camera(time), truth))
    return scene.exposure, moments


def shown(device: Device, exposure: float, moments: list[Moment], threshold: float | None) -> tuple[float, float]:
    """Return PSNR in dB of the new frames with a static threshold (None: automatic), and the share of dynamic
    pixels."""
    options = Options(shading_correction=False, static_threshold=threshold)
    pipeline = Pipeline(device, *SIZE, options, fps=FPS)
    pipeline.exposure = exposure
    errors, shares = [], []
    for k, moment in enumerate(moments):
        pipeline.submit(moment.frame)
        if k < NO_HISTORY:
            continue
        made = pipeline.extrapolate(moment.camera, moment.time)
        errors.append(squared_error(to_display(made.numpy("color"), exposure), moment.truth).mean())
        shares.append((pipeline.stages["history"].read("dynamic_mask") > 0).mean())
    return decibels(float(np.mean(errors))), float(np.mean(shares))


def visible(moments: list[Moment], stored: list[Moment]) -> float:
    """Return the share of pixels whose exact motion differs from that of static surfaces by more than 99% of the
    encoding's errors of that component and direction do, and by more than the least threshold."""
    shares = []
    for k in range(NO_HISTORY, len(moments)):
        residual, direction = _residual(moments[k].frame, moments[k - 1].frame)
        error = np.abs(_residual(stored[k].frame, stored[k - 1].frame)[0] - residual)
        known = np.isfinite(error) & np.isfinite(moments[k].frame.depth)[..., None]
        seen = np.zeros(known.shape, bool)
        for c, sign in ((c, sign) for c in (0, 1) for sign in (False, True)):
            of = known[..., c] & ((direction[..., c] < 0) == sign)
            if of.any():
                seen[..., c] |= of & (np.abs(residual[..., c]) > max(np.quantile(error[..., c][of], 0.99), LEAST))
        shares.append(seen.any(-1).mean())
    return float(np.mean(shares))


def _residual(frame: RenderedFrame, before: RenderedFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return motion (H, W, 2) less that of static surfaces, and that."""
    static, _ = static_motion(frame.depth, frame.camera, before.camera)
    return frame.motion - static, static


def measured(device: Device, name: str, seed: int, encodings: tuple[str, ...]) -> list[Cell]:
    """Return the cells of one scene."""
    print(f"\r{name}, seed {seed}".ljust(40), end="", file=sys.stderr, flush=True)
    exposure, moments = render(device, name, seed)
    best, exact = shown(device, exposure, moments, None)
    cells = []
    for text in encodings:
        encoding = Encoding.parse(text) if text else EXACT
        stored = [replace(moment, frame=encoding.frame(moment.frame, exposure)) for moment in moments]
        psnr = {f"{pixels:g}": shown(device, exposure, stored, pixels)[0] for pixels in FIXED}
        psnr["automatic"], dynamic = shown(device, exposure, stored, None)
        cells.append(Cell(name, seed, text, psnr, dynamic, exact, visible(moments, stored), best - psnr["automatic"]))
    return cells


def encodings_table(cells: list[Cell]) -> str:
    """Return a line for each encoding."""
    rows = []
    for text in dict.fromkeys(cell.encoding for cell in cells):
        of = [cell for cell in cells if cell.encoding == text]
        close = sum(cell.is_close_to(cell.exact) for cell in of), sum(cell.is_close_to(cell.visible) for cell in of)
        gains, factors = [cell.gain for cell in of], [cell.factor for cell in of]
        rows.append(
            (
                f"`{text}`" if text else "exact",
                signed(-np.mean([cell.loss for cell in of])),
                f"{signed(np.mean(gains))}; {signed(min(gains))} ({min(of, key=lambda cell: cell.gain).scene})",
                f"{sum(gain >= -BELOW for gain in gains)} of {len(of)}",
                f"{min(factors):.2f} to {max(factors):.2f}",
                f"{close[0]}, {close[1]}",
            )
        )
    heads = ("encoding", "against exact buffers, dB", "against the best fixed ε, dB: mean; worst")
    heads += (f"no more than {BELOW:g} dB below",)
    return table((*heads, "dynamic / exact share", f"within a factor of {FACTOR:g} of exact, of visible"), rows)


def signed(value: float) -> str:
    return f"{round(value, 2) + 0.0:+.2f}".replace("-", "−")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="into docs/deviations.md and docs/measured/encodings.json")
    parser.add_argument("--json", type=Path, help="file for all figures")
    parser.add_argument("--grid", action="store_true", help="also a line for each scene and encoding")
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=list(SCENES))
    parser.add_argument(
        "--encodings", nargs="*", default=list(ENCODINGS), help='as of gffe render --encode, "" for none'
    )
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--device")
    given = parser.parse_args()
    device, cells = open_device(given.device), []
    for seed in range(given.seeds):
        for name in given.scenes:
            cells += measured(device, name, seed, tuple(given.encodings))
    for cell in cells if given.grid else ():
        print(f"{cell.scene:10} {cell.encoding or 'exact':20} {signed(cell.gain)} dB, dynamic × {cell.factor:.2f}")
    made = encodings_table(cells)
    print(f"\n{made}", flush=True)
    if given.write:
        write_tables("deviations.md", {"encodings": made})
    for path in filter(None, (given.json, RECORD if given.write else None)):
        figures = [vars(cell) | {"gain": cell.gain, "factor": cell.factor} for cell in cells]
        path.write_text(json.dumps(figures, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
