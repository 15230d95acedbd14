"""Gain of each deviation from the paper on the corpus.

    python docs/tools/measure_deviations.py             prints the figures of docs/deviations.md, in 20 minutes
    python docs/tools/measure_deviations.py --write     puts them there, and into docs/measured

Each row takes the paper's way in one point and keeps everything else: by an option of the pipeline where there is one,
else by a change to a copy of the kernels. All sequences of the group "scenes" are pooled: PSNR of the mean squared
error of display values. Figures are cached, as by `quality.py`.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from corpus import Line, corpus_lines, rendered
from pages import DOCS, REPOSITORY, table, with_all, write_record
from quality import VARIANTS, Side, cells_of, show_progress, signed

from gffe_cl.engine.opencl.device import open_device
from gffe_cl.lab.metrics import REGIONS, decibels

HALF, HALF_GAE, WHOLE, WHOLE_GAE = VARIANTS  # α = ½ and 1, with the network and without
HOLES = "out of screen", "static disocclusion", "dynamic disocclusion"
PARTS_OF_FRAME = {
    "whole frame": tuple(REGIONS),
    "holes": HOLES,
    "movers": ("dynamic",),
    "the rest": tuple(name for name in REGIONS if name not in (*HOLES, "dynamic")),
}


@dataclass(frozen=True)
class Change:
    """The paper's way in one point.

    options : of the pipeline
    constants : by kernel file, of its `#define`s
    edits : by kernel file, pieces of its text (white space is as it comes) with what takes their place
    camera : whether the new frame's true camera is known
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
            "connectivity.cl": {"frame->levels && frame->has_previous;": "true;"},
            "background.cl": {
                "!frame->has_previous && texel": "!frame->has_previous && level > 0 && texel",
                "if (!frame->has_previous) return;": "",
            },
        }
    ),
    "nothing is collected beside movers and nearer surfaces": Change(
        edits={
            "connectivity.cl": {
                "settled = (row.z > 0.0f) & (to_ints(moving) == 0)": "settled = row.z > 0.0f",
                "clean = settled & !(nearest < row.z * MIXES_IN)": "clean = settled",
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
    "background texels cover what they map to": Change(constants={"projection.cl": {"TEXEL_HALF": "0.0f"}}),
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
CARRIED = Change(constants={"acceleration.h": {"IN_VIEW": "0.0f", "KEEPS_UP": "0.0f"}})
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
            }
        }
    ),
    "a small focus mask is 0": Change(constants={"correction.cl": {"LEAST_MASK": "0.0f"}}),
    "texture stays whatever the network says": Change(constants={"shading_flow.cl": {"TEXTURE": "-1e30f"}}),
    "(focus mask, as in the paper)": Change({"focus_mask": False}),
}
# For situations: the part that is for each, with what takes its place. Both ways go without their own part alone:
# "handheld" has predicted cameras throughout.
NO_NETWORK = Change({"shading_correction": False})
FOR_SITUATIONS: dict[str, tuple[str, Change]] = {
    "bars": ("hidden parts of movers", GAE["hidden parts of movers"]),
    "railings": ("movers that come into view", Change({"entering": False})),
    "balls": ("acceleration", GAE["movers' acceleration goes on"]),
    "rotors": ("acceleration", GAE["movers' acceleration goes on"]),
    "handheld": ("`--camera-order auto`; 1", Change({"camera_order": 1})),
    "cab": ("fixed to the camera", CAMERA_FIXED),
    "wipers": ("what the camera carries", CARRIED),
    "shadows": ("network", NO_NETWORK),
    "fan": ("network", NO_NETWORK),
}


PAGE = DOCS / "deviations.md"
WAYS = "the paper's way", "all", "all but that part"
_GAIN = "gain in dB, PSNR over"
HEADS = {
    "gae": (_GAIN, *PARTS_OF_FRAME),
    "parts": ("gain in dB", *(f"{part}, α = {alpha}" for part in PARTS for alpha in ("½", "1"))),
    "scn": (_GAIN, *PARTS_OF_FRAME),
    "situations": ("PSNR, dB", *(f"{way}, α = {alpha}" for alpha in ("½", "1") for way in WAYS)),
    "encodings": ("sequence, encoding", "against exact buffers, dB", "against the best fixed ε, dB"),
}
PLAIN = "levels", "situations"  # parts of the record that are no gains
FIXED = (1.0, 1.4, 2.0, 2.8, 4.0)  # pixels: static thresholds to compare the automatic one with


class Measure:
    """Figures of changes on the corpus."""

    def __init__(self, lines: list[Line]):
        device = open_device(None)
        self.files = {line.name: rendered(line, device) for line in lines}

    def cells(self, name: str, change: Change, lines: Iterable[Line]) -> dict[str, dict]:
        """Return the cells of the working tree with a change, by name of the sequence."""
        chosen = [line if change.camera else replace(line, camera="predicted") for line in lines]
        with tempfile.TemporaryDirectory() as folder:
            kernels = Path(folder) / "kernels"
            shutil.copytree(REPOSITORY / "kernels", kernels)
            for file in {*change.constants, *change.edits}:
                (kernels / file).write_text(change.applied(file, (kernels / file).read_text()))
            return cells_of(Side(name, REPOSITORY, kernels, change.options), chosen, self.files, show_progress)


def pooled(cells: Iterable[dict], variant: str, part: str = "whole frame") -> tuple[float, int]:
    """Return the PSNR in dB of all squared errors of a variant in a part of the frame, and its pixels."""
    found = [cell[variant]["regions"][name] for cell in cells for name in PARTS_OF_FRAME[part]]
    total, count = map(sum, zip(*found, strict=True))
    return decibels(total / max(count, 1)), count


def gains(cells: dict[str, dict], variant: str) -> dict[str, list[float]]:
    """Return by how many dB the first of `cells`, by name, is better than each other one, for `PARTS_OF_FRAME`."""
    levels = {name: [pooled(of.values(), variant, part)[0] for part in PARTS_OF_FRAME] for name, of in cells.items()}
    ours, *names = levels
    return {name: [round(a - b, 3) for a, b in zip(levels[ours], levels[name], strict=True)] for name in names}


def measured() -> dict[str, dict[str, Any]]:
    """Return the figures of the tables: by table and row."""
    groups = "scenes", "situations", "encoded"
    scenes, situations, encoded = ([line for line in corpus_lines() if line.group == group] for group in groups)
    measure, record = Measure([*scenes, *situations, *encoded]), {}

    ways = {"": Change(), **GAE, "**all of these together**": PAPER}
    ways |= {f"{name} (against: {other})": change for name, (change, other) in CHOICES.items()}
    cells = {name: measure.cells(name, change | NO_NETWORK, scenes) for name, change in ways.items()}
    levels = [pooled(cells[""].values(), HALF_GAE, part) for part in PARTS_OF_FRAME]
    record["levels"] = {
        "share of the pixels, %": [round(100 * count / levels[0][1], 1) for _, count in levels],
        "PSNR with all of these, dB": [round(level, 2) for level, _ in levels],
    }
    record["gae"] = gains(cells, HALF_GAE)
    record["parts"] = {}
    for scene in dict.fromkeys(line.generator for line in scenes):
        of = {name: {k: v for k, v in cells[name].items() if k.startswith(f"{scene}:")} for name in ("", *PARTS)}
        half, whole = (gains(of, variant) for variant in (HALF_GAE, WHOLE_GAE))
        record["parts"][scene] = [value for part in PARTS for value in (half[part][0], whole[part][0])]

    ways = {"": Change(), **SCN}
    record["scn"] = gains({name: measure.cells(name, change, scenes) for name, change in ways.items()}, HALF)

    record["situations"] = {}
    for name, (part, without) in FOR_SITUATIONS.items():
        of = [line for line in situations if line.generator == name]
        ways = PAPER | NO_NETWORK | Change({"camera_order": 1}), Change(), without
        found = [measure.cells(f"{name}, {way}", change, of) for way, change in zip(WAYS, ways, strict=True)]
        levels = [pooled(cells.values(), variant)[0] for variant in (HALF, WHOLE) for cells in found]
        record["situations"][f"`{name}`: {part}"] = [round(level, 2) for level in levels]

    record["encodings"] = {}
    thresholds = {value: Change({"static_threshold": value}) | NO_NETWORK for value in (None, *FIXED)}
    found = {value: measure.cells(f"ε {value}", change, encoded) for value, change in thresholds.items()}
    psnr = {value: {name: cell[HALF_GAE]["psnr"] for name, cell in of.items()} for value, of in found.items()}
    for line in encoded:
        best = max(psnr[value][line.name] for value in FIXED)
        own, exact = psnr[None][line.name], psnr[None][f"{line.generator}:{line.seed}, exact"]
        record["encodings"][line.name] = [round(own - other, 3) for other in (exact, best)]
    show_progress("")
    return record


def with_tables(page: str, record: dict[str, Any]) -> str:
    """Return docs/deviations.md with the tables of a record."""
    rows = {name: [(row, *map(signed, values)) for row, values in record[name].items()] for name in HEADS}
    plain = {name: [(row, *(f"{v:.2f}" for v in values)) for row, values in record[name].items()] for name in PLAIN}
    rows["gae"][:0] = plain["levels"]
    rows["situations"] = plain["situations"]
    return with_all(page, {name: table(heads, rows[name]) for name, heads in HEADS.items()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="into docs/deviations.md and docs/measured")
    given = parser.parse_args()
    record = measured()
    if not given.write:
        print(json.dumps(record, indent=1, ensure_ascii=False))
        return
    write_record("deviations", record)
    PAGE.write_text(with_tables(PAGE.read_text("utf-8"), record), "utf-8")


if __name__ == "__main__":
    main()
