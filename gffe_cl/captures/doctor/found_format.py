"""Found format: what undoes the faults of a capture, as JSON to paste, and the sequence that it makes of one.

{"frame_format": {fields of FrameFormat}, "files": {"motion": {"frame_offset": 1}}, "cameras": {"convention": "opengl"}}
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.captures.doctor.findings import Finding
from gffe_cl.captures.doctor.readings import VIEW_AXES, Cameras
from gffe_cl.captures.formats.capture import Keys
from gffe_cl.captures.sequence import FrameEntry, Sequence
from gffe_cl.captures.sequence.description import Description
from gffe_cl.captures.sequence.engine_form import color_of, described_frame
from gffe_cl.captures.sequence.exr import Pixels
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_positive, require_whole
from gffe_cl.engine.frame.frame_format import NO_JITTER, FrameFormat, jitter_in_color, require_render_size
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_BUFFERS = ("color", "depth", "motion", "camera")
_CAMERAS = {
    "convention": tuple(VIEW_AXES),
    "matrix": ("world_to_view", "view_to_world"),
    "rotation": ("as stored", "transposed"),
    "translation": ("as stored", "position"),
    "jitter": ("as stored", "geometry_jitter"),
}
_MOST_OFFSET = 16  # frames


@dataclass(frozen=True)
class FoundFormat:
    """Description of a capture's buffers that replaces its own one. `frame_offset`: by buffer, or "camera", how many
    frames after its own file that of a frame is; `cameras`: how its camera matrices are meant."""

    frame_format: FrameFormat = field(default_factory=FrameFormat)
    frame_offset: dict[str, int] = field(default_factory=dict)
    cameras: Cameras = field(default_factory=Cameras)

    @classmethod
    def of(cls, findings: Iterable[Finding], declared: FrameFormat) -> FoundFormat:
        """Return the format that undoes `findings` in frames that were converted from `declared`."""
        fields, offsets, keys = {}, {}, {}
        for one in findings:
            fields |= one.fields
            offsets |= one.offsets
            keys |= one.camera_keys
        return cls(replace(declared, **fields), offsets, Cameras(**keys))

    def to_json(self) -> dict[str, Any]:
        made: dict[str, Any] = {"frame_format": self.frame_format.to_json()}
        if self.frame_offset:
            made["files"] = {buffer: {"frame_offset": by} for buffer, by in self.frame_offset.items()}
        return made | ({"cameras": self.cameras.keys()} if self.cameras.keys() else {})

    @classmethod
    def from_json(cls, given: Any) -> FoundFormat:
        """Return the format of which `to_json` gave the JSON. Raises GffeError for anything else."""
        document = Keys(given, "format")
        fields, files = document.take("frame_format", {}), Keys(document.take("files", {}), "format: files")
        offsets, keys = {}, Keys(document.take("cameras", {}), "format: cameras")
        document.done()
        for buffer in _BUFFERS:
            if (given := files.take(buffer)) is not None:
                file = Keys(given, f"format: {buffer}")
                by = file.take("frame_offset", 0)
                offsets[buffer] = require_whole(by, f"{file.label}, frame_offset", -_MOST_OFFSET, _MOST_OFFSET)
                file.done()
        files.done()
        cameras: dict[str, Any] = {name: keys.choice(name, values, values[0]) for name, values in _CAMERAS.items()}
        cameras["focal_scale"] = require_positive(keys.take("focal_scale", 1.0), "format: focal_scale")
        keys.done()
        return cls(FrameFormat.from_json(fields), offsets, Cameras(**cameras))

    @classmethod
    def open(cls, path: Path) -> FoundFormat:
        """Return the format in the JSON file `path`. Raises GffeError that names it."""
        try:
            return cls.from_json(json.loads(path.read_text("utf-8")))
        except OSError as error:
            raise GffeError(f"{path}: cannot be read ({error.strerror or error})") from None
        except (ValueError, RecursionError):
            raise GffeError(f"{path}: no JSON (expected the file of `gffe check --format-out`)") from None


def with_format(sequence: Sequence, found: FoundFormat) -> Sequence:
    """Return `sequence` as `found` describes it, in our conventions. Frames at the ends, some of whose buffers were not
    recorded, are left out. Raises GffeError if no rendered frame is left; reading raises it as usual."""
    given = sequence.rendered
    sources: dict[str, dict[str, FrameEntry]] = {}
    rendered: list[FrameEntry] = []
    was_left_out = False
    for k, entry in enumerate(given):
        at = {buffer: k + found.frame_offset.get(buffer, 0) for buffer in _BUFFERS}
        low, high = min(at.values()), max(at.values())
        if low < 0 or high >= len(given) or any(one.reset for one in given[low + 1 : high + 1]):
            was_left_out = True
            continue
        sources[entry.file] = {buffer: given[n] for buffer, n in at.items()}
        other = sources[entry.file]["camera"]
        size = sequence.size_of(entry)
        geometry = require_render_size(sequence.format, size, entry.geometry_size)
        jitter = np.array(jitter_in_color(entry.geometry_jitter, size, geometry))
        render, shown = other.render_camera, other.display_camera
        read = {
            "render_camera": render and found.cameras.read(render, jitter),
            "display_camera": shown and found.cameras.read(shown, jitter * (shown == render)),
        }
        converted: dict[str, Any] = {"geometry_size": None}  # as `_FoundPixels.read` returns them
        if geometry != size:
            converted["geometry_jitter"] = NO_JITTER
        rendered.append(replace(entry, reset=entry.reset or was_left_out or k == 0, **converted, **read))
        was_left_out = False
    if given and not rendered:
        raise GffeError(f"{sequence.path}: no rendered frame is left with these frame offsets")
    others = [
        replace(one, display_camera=one.display_camera and found.cameras.read(one.display_camera, np.zeros(2)))
        for one in sequence.frames
        if one.kind == "ground_truth"
    ]
    frames = sorted([*rendered, *others], key=lambda one: one.time)
    size = sequence.width, sequence.height
    description = Description(*size, sequence.fps, sequence.exposure, frames, sequence.unfinished)
    return Sequence(sequence.path, description, _FoundPixels(sequence, found, rendered, sources))


class _FoundPixels(Pixels):
    """Pixels of `sequence` as `found` describes them; `sources`: {file → {buffer → entry that has it}}."""

    def __init__(
        self,
        sequence: Sequence,
        found: FoundFormat,
        rendered: list[FrameEntry],
        sources: dict[str, dict[str, FrameEntry]],
    ):
        super().__init__()
        self._sequence, self._found, self._sources = sequence, found, sources
        self._before = dict(zip([one.file for one in rendered[1:]], rendered, strict=False))

    def read(self, entry: FrameEntry, size: tuple[int, int]):
        source = self._sources[entry.file]
        stored = {file: self._sequence.read_stored(one) for file, one in {s.file: s for s in source.values()}.items()}
        color, depth, motion = (stored[source[buffer].file] for buffer in ("color", "depth", "motion"))
        frame = replace(
            depth, color=color.color, motion=motion.motion, camera=entry.render_camera, overlays=color.overlays
        )
        made = self._converted(frame, self._found.frame_format, None if entry.reset else self._before.get(entry.file))
        return made.color, made.depth, made.motion, made.overlays

    def _converted(self, frame: RenderedFrame, format: FrameFormat, before: FrameEntry | None) -> RenderedFrame:
        jitter = NO_JITTER
        if before is not None:
            height, width = np.shape(frame.color)[:2]
            rows, columns = np.shape(frame.depth)
            stored = self._sources[before.file]["depth"].geometry_jitter
            jitter = jitter_in_color(stored, (width, height), (columns, rows))
        return described_frame(frame, format, before and before.render_camera, jitter)

    def color(self, entry: FrameEntry, size: tuple[int, int]) -> np.ndarray:
        if entry.file in self._sources:
            return self.read(entry, size)[0]
        return color_of(self._sequence.read_color(entry), self._found.frame_format)

    def channels(self, entry: FrameEntry, names: Iterable[str], size: tuple[int, int]) -> dict[str, np.ndarray]:
        return self._sequence.read_channels(entry, names)
