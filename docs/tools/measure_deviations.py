"""Gain of each deviation from the paper on the built-in scenes.

    python docs/tools/measure_deviations.py             prints the tables of docs/deviations.md
    python docs/tools/measure_deviations.py --write     puts them there

Each row takes the paper's way in one point and keeps everything else: by an option of the pipeline where there is one,
else by a change to a copy of the kernels. All frames of all scenes are pooled: PSNR of the mean squared error of
display values.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pages import table, write_tables
from situation_regions import region_of_situation, submitted_frames

from gffe_cl.captures.scenes import SCENES, SITUATIONS, SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.opencl.program import kernel_folder
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.metrics import METRICS, RegionErrors, to_display

ALPHA, FPS = 0.5, 30.0
ALPHAS = (0.25, 0.5, 0.75, 1.0)
REGIONS = ("whole", "holes", "moving", "rest")
PSNR = (METRICS["psnr"],)


@dataclass(frozen=True)
class Change:
    """The paper's way in one point.

    options : of the pipeline
    constants : by kernel file, of its `#define`s
    edits : by kernel file, pieces of its text (white space is as it comes) with what takes their place
    camera : whether the frame's true camera is known
    """

    options: dict[str, object] = field(default_factory=dict)
    constants: dict[str, dict[str, str]] = field(default_factory=dict)
    edits: dict[str, dict[str, str]] = field(default_factory=dict)
    camera: bool = True

    def __or__(self, other: Change) -> Change:
        def merged(a: dict, b: dict) -> dict:
            return {name: a.get(name, {}) | b.get(name, {}) for name in a | b}

        return Change(
            self.options | other.options,
            merged(self.constants, other.constants),
            merged(self.edits, other.edits),
            self.camera and other.camera,
        )

    def applied(self, file: str, text: str) -> str:
        """Return `text` of kernel `file` with the changes. Raises ValueError for one that finds nothing to change."""
        for name, value in self.constants.get(file, {}).items():
            # up to the comment, which may go on in the next line
            text, found = re.subn(
                rf"^#define {name} .*?(?=\s*/\*|$)", f"#define {name} {value}", text, flags=re.MULTILINE
            )
            if found != 1:
                raise ValueError(f"kernels/{file}: expected '#define {name}' once, found it {found} times")
        for old, new in self.edits.get(file, {}).items():
            if text.count(old) != 1:
                raise ValueError(f"kernels/{file}: expected '{old}' once, found it {text.count(old)} times")
            text = text.replace(old, new)
        return text


# By the names in docs/deviations.md.
GAE: dict[str, Change] = {
    "fragments cover what their pixel maps to": Change({"crack_closing": False}),
    "color is resampled at its sub-pixel position": Change(constants={"warp.cl": {"STILL": "1e9f"}}),
    "resampling is cubic, not bilinear": Change({"blocks": False}, {"resampling.h": {"ALL_ALIKE": "0x1FF"}}),
    "colors are mixed as they are seen": Change({"resampling": "linear"}),
    "… above display white the code is compressed": Change(
        edits={"color_code.h": {"root > white_root ?": "false ?", "size > white ?": "false ?"}}
    ),
    "edges are as sharp as earlier frames were": Change({"sharpness": False}),
    "no colors mixed with a silhouette that moves away": Change(constants={"warp.cl": {"MOVES_AWAY": "1e30f"}}),
    "the surface met at x' is checked": Change(
        constants={"history.cl": {"DEPTH_TOLERANCE": "1e30f", "SEARCH_RADIUS": "0"}}
    ),
    "movers' acceleration goes on": Change({"acceleration": False}),
    "nothing is collected after a reset": Change(
        edits={
            "connectivity.cl": {"if (!collect) return;": ""},
            "background.cl": {
                "!frame->has_previous && texel": "!frame->has_previous && level > 0 && texel",
                "if (!frame->has_previous) return;": "",
            },
        }
    ),
    "nothing is collected beside movers and nearer surfaces": Change(
        edits={
            "connectivity.cl": {
                "settled = (z > 0.0f) & (moving == 0)": "settled = z > 0.0f",
                "clean = settled & !(nearest < z * MIXES_IN)": "clean = settled",
            }
        }
    ),
    "fragments must be deeper by a margin (case 2)": Change(
        constants={"background.cl": {"BEHIND": "1.0f"}},
        edits={
            "background.cl": {
                "z > z_shown + *margin;": "z > z_shown;",
                "z > z_level + level_margin)": "z > z_level)",
            }
        },
    ),
    "background texels cover what they map to": Change(constants={"background.cl": {"TEXEL_HALF": "0.0f"}}),
    "hidden parts of movers": Change({"hidden_parts": False}),
    "… the frame before must not have shown anything farther": Change(
        edits={"hidden_parts.cl": {"if (!frame->has_previous ||": "if (true ||"}}
    ),
    "parts that the frame before showed reappear": Change({"reappearing": False}),
    "holes continue their far side": Change({"hole_filling": "downsample"}),
    "holes continue surfaces that can be there": Change(
        edits={"holes.cl": {"return !INVALID_DEPTH(shown) && !(px_source.z < IN_FRONT * shown);": "return false;"}}
    ),
    "what lies beyond the image has no far side": Change(
        edits={"holes.cl": {"s.is_outside = is_out": "s.is_outside = false && is_out"}}
    ),
    "silhouettes stay antialiased": Change({"soft_silhouettes": False}),
}
# Beyond the paper, each a module with an option of its own.
PARTS = ("silhouettes stay antialiased", "hidden parts of movers", "movers' acceleration goes on")
CARRIED = Change(constants={"acceleration.cl": {"IN_VIEW": "0.0f", "KEEPS_UP": "0.0f"}})
CAMERA_FIXED = Change({"camera_fixed": False})  # worth something only on "cab" and "wipers"
PAPER = CAMERA_FIXED
for change in GAE.values():
    PAPER |= change
CHOICES: dict[str, tuple[Change, str]] = {
    "linear prediction": (Change({"history": 3, "order": 2}), "quadratic prediction"),
    "camera of the frame known": (Change(camera=False), "camera predicted"),
}
SCN: dict[str, Change] = {
    "previous frame only where its surface was shown": Change(
        edits={
            "warped_previous.h": {
                "float tolerance = SAME_SURFACE *": "float tolerance = 1e30f *",
                "Floats tolerance = SAME_SURFACE *": "Floats tolerance = 1e30f *",
                "most - least <= SAME_SURFACE * mean": "true",
            }
        }
    ),
    "a small focus mask is 0": Change(constants={"correction.cl": {"LEAST_MASK": "0.0f"}}),
    "texture stays whatever the network says": Change(constants={"shading_flow.cl": {"TEXTURE": "-1e30f"}}),
    "(focus mask, as in the paper)": Change({"focus_mask": False}),
}
# For situations: the part that is for each, with what takes its place, and the region concerned. Both ways go without
# their own part alone: "handheld" is measured with predicted cameras throughout.
NO_NETWORK = Change({"shading_correction": False})
PREDICTED = Change(camera=False)
FOR_SITUATIONS: dict[str, tuple[str, Change, str]] = {
    "bars": ("hidden parts of movers", GAE["hidden parts of movers"], "movers"),
    "balls": ("acceleration", GAE["movers' acceleration goes on"], "movers"),
    "rotors": ("acceleration", GAE["movers' acceleration goes on"], "movers"),
    "handheld": ("`--camera-order auto`; 1", PREDICTED | Change({"camera_order": 1}), "all"),
    "cab": ("fixed to the camera", CAMERA_FIXED, "movers"),
    "wipers": ("what the camera carries", CARRIED, "movers"),
    "shadows": ("network", NO_NETWORK, "light"),
    "fan": ("network", NO_NETWORK, "light"),
}


@contextmanager
def kernels_with(change: Change) -> Iterator[None]:
    """Pipelines made here use kernels with `change`."""
    before = os.environ.get("GFFE_KERNELS")
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "kernels"
        shutil.copytree(kernel_folder(), made)
        for file in {*change.constants, *change.edits}:
            (made / file).write_text(change.applied(file, (made / file).read_text()))
        os.environ["GFFE_KERNELS"] = str(made)
        try:
            yield
        finally:
            if before is None:
                del os.environ["GFFE_KERNELS"]
            else:
                os.environ["GFFE_KERNELS"] = before


def measure(
    device: Device, changes: dict[str, Change], options: Options, setting: argparse.Namespace
) -> dict[str, RegionErrors]:
    """Return errors of `options` with each of `changes`, over all scenes; the first one's holes and movers are the
    regions."""
    errors = {name: RegionErrors() for name in changes}
    for scene_name in setting.scenes:
        for seed in range(setting.seeds):
            for _, truth, shown, regions in shown_frames(
                device, changes, options, setting, (scene_name, seed), (ALPHA,)
            ):
                for name, picture in shown.items():
                    errors[name].add(picture, truth, regions, PSNR)
    return errors


def shown_frames(
    device: Device,
    changes: dict[str, Change],
    options: Options,
    setting: argparse.Namespace,
    scene_and_seed: tuple[str, int],
    alphas: tuple[float, ...],
    concerned: str | None = None,
) -> Iterator[tuple[float, np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]]:
    """Yield each new frame of a scene: α, the truth and the results of `options` with each of `changes`, as display
    values, and the regions (masks) by the first of `changes`; or, with `concerned`, the whole and that region of a
    situation."""
    print(f"\r{scene_and_seed[0]}, seed {scene_and_seed[1]}".ljust(40), end="", file=sys.stderr, flush=True)
    scene = load_scene(*scene_and_seed)
    frames = SceneFrames(SceneRenderer(device, scene, *setting.size))
    pipelines = {}
    for name, change in changes.items():
        with kernels_with(change):
            pipelines[name] = Pipeline(device, *setting.size, replace(options, **change.options), fps=FPS)
        pipelines[name].exposure = scene.exposure
    for _, frame, measured in submitted_frames(frames, pipelines.values(), setting.frames, FPS, ALPHA):
        for alpha in alphas if measured is not None else ():
            time = frame.time + alpha / FPS
            camera = frames.display_camera(time)
            truth = to_display(frames.truth(time).read("color"), scene.exposure)
            shown, regions = {}, {}
            for name, pipeline in pipelines.items():
                made = pipeline.extrapolate(camera if changes[name].camera else None, time)
                regions = regions or (_regions(made) if concerned is None else {})
                shown[name] = to_display(made.numpy("color"), scene.exposure)
            if concerned:
                region = region_of_situation(concerned, frames, (frame.time, frame.time - 1 / FPS), time)
                regions = {"whole": np.ones_like(region), "region": region}
            yield alpha, truth, shown, regions


def _regions(made) -> dict[str, np.ndarray]:
    holes, moving = made.numpy("disoccluded") > 0, made.numpy("dynamic") > 0
    parts = (np.ones_like(holes), holes, moving & ~holes, ~moving & ~holes)
    return dict(zip(REGIONS, parts, strict=True))


def signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def gains(errors: dict[str, RegionErrors], rows: dict[str, str]) -> list[tuple[str, ...]]:
    """Return rows of a table: by how much the errors without a change are below those of each row, dB."""
    ours = errors[""]
    return [
        (title, *(signed(ours.figure("psnr", r) - errors[name].figure("psnr", r)) for r in REGIONS))
        for name, title in rows.items()
    ]


def gae_table(device: Device, setting: argparse.Namespace) -> str:
    changes = {"": Change(), **GAE, "all": PAPER} | {name: change for name, (change, _) in CHOICES.items()}
    errors = measure(device, changes, Options(shading_correction=False), setting)
    rows = {name: name for name in GAE} | {"all": "**all of these together**"}
    rows |= {name: f"{name} (against: {other})" for name, (_, other) in CHOICES.items()}
    ours = errors[""]
    shares = ("share of the pixels", *(f"{ours.share(r):.1%}" for r in REGIONS))
    levels = ("PSNR with all of these, dB", *(f"{ours.figure('psnr', r):.2f}" for r in REGIONS))
    return table(GAIN_HEADS, [shares, levels, *gains(errors, rows)])


def scn_table(device: Device, setting: argparse.Namespace) -> str:
    errors = measure(device, {"": Change(), **SCN}, Options(shading_correction=True), setting)
    return table(GAIN_HEADS, gains(errors, {name: name for name in SCN}))


def parts_table(device: Device, setting: argparse.Namespace) -> str:
    """Return the gain of each part beyond the paper by scene and α, PSNR of the whole frame."""
    changes = {"": Change()} | {name: GAE[name] for name in PARTS}
    rows = []
    for scene in setting.scenes:
        by_alpha = {alpha: {name: RegionErrors() for name in changes} for alpha in ALPHAS}
        for seed in range(setting.seeds):
            for alpha, truth, shown, regions in shown_frames(
                device, changes, Options(shading_correction=False), setting, (scene, seed), ALPHAS
            ):
                for name, picture in shown.items():
                    by_alpha[alpha][name].add(picture, truth, regions, PSNR)
        row = [scene]
        for part in PARTS:
            of_alphas = (gains(errors, {part: part})[0][1] for errors in by_alpha.values())
            row.append(", ".join(of_alphas))
        rows.append(row)
    return table((f"gain in dB, α = {', '.join(f'{a:g}' for a in ALPHAS)}", *PARTS), rows)


def situations_table(device: Device, setting: argparse.Namespace) -> str:
    """Return PSNR by situation: the paper's way, everything, and everything but the part that is for it."""
    ways = ("the paper's way", "all", "all but that part")
    heads = [f"{way}, α = {alpha:g}" for alpha in (0.5, 1.0) for way in ways]
    rows = []
    for name, (part, without, region) in FOR_SITUATIONS.items():
        known = Change() if without.camera else PREDICTED
        changes = dict(zip(ways, (PAPER | NO_NETWORK | known, known, without), strict=True))
        changes[ways[0]].options.update(camera_order=1)
        errors = {(alpha, way): RegionErrors() for alpha in (0.5, 1.0) for way in ways}
        for seed in range(setting.seeds):
            for alpha, truth, shown, regions in shown_frames(
                device, changes, Options(), setting, (name, seed), (0.5, 1.0), concerned=region
            ):
                for way, picture in shown.items():
                    errors[alpha, way].add(picture, truth, regions, PSNR)
        share = errors[0.5, ways[0]].share("region")
        figures = (f"{e.figure('psnr', 'whole'):.2f} / {e.figure('psnr', 'region'):.2f}" for e in errors.values())
        rows.append((f"`{name}`", part, f"{region}, {share:.0%}", *figures))
    return table(("PSNR, dB: frame / region", "part", "region", *heads), rows)


GAIN_HEADS = ("gain in dB, PSNR over", "whole frame", "holes", "movers", "the rest")
TABLES: dict[str, Callable[[Device, argparse.Namespace], str]] = {
    "gae": gae_table,
    "parts": parts_table,
    "scn": scn_table,
    "situations": situations_table,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="into docs/deviations.md")
    parser.add_argument("--tables", nargs="*", choices=TABLES, default=list(TABLES))
    parser.add_argument("--scenes", nargs="*", choices=(*SCENES, *SITUATIONS), default=list(SCENES))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--size", type=int, nargs=2, default=(480, 270))
    parser.add_argument("--device")
    setting = parser.parse_args()
    device = open_device(setting.device)
    for name in setting.tables:
        made = TABLES[name](device, setting)
        print(f"\n{made}", flush=True)
        if setting.write:
            write_tables("deviations.md", {name: made})


if __name__ == "__main__":
    main()
