"""What the buffers of one slot hold: whole layers, the values at a pixel, the story of how that pixel came about."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl

from gffe_cl.camera import Camera
from gffe_cl.pipeline import Pipeline
from gffe_cl.stage import BY_CRACK_CLOSING, BY_HOLE_FILLING, BY_NOTHING, FILLED_BY
from gffe_cl.stages.holes import FILLINGS

_REMEMBERED = 2  # in `state_l`
_SAME_SURFACE = 0.04  # relative depth within which texels of a level are mixed, as in background.cl


@dataclass(frozen=True)
class Shot:
    """The slot that a pipeline's buffers hold.

    Attributes
    ----------
    k, alpha, time
        `alpha` is 0 for rendered frame k itself; `time` in seconds.
    camera : Camera
        Of what is shown, display pixels.
    render_camera, display_camera : Camera
        What frame k was rendered through, in its pixels, and what is shown of it, in display pixels.
    previous_camera : Camera or None
        What the frame before was rendered through; None after a reset.
    whole : bool
        The rendered image is shown as rendered, stretched over the display.
    buffers : dict
        Device buffers of the frame's own layers: "final", "rendered.color", "rendered.depth", "rendered.motion"; for a
        rendered slot also "truth", the display part; "gae" with shading correction; "focus_truth" once it is made.
    """

    k: int
    alpha: float
    time: float
    camera: Camera
    render_camera: Camera
    display_camera: Camera
    previous_camera: Camera | None
    whole: bool
    buffers: dict[str, cl.Buffer]


@dataclass(frozen=True)
class DeviceLayer:
    """An image in a device buffer: (planes, H, W, channels) of `dtype`; `grid` as in `BufferSpec`."""

    buffer: cl.Buffer
    dtype: type
    grid: str
    size: tuple[int, int]
    planes: int
    channels: int

    def read(self, queue: cl.CommandQueue) -> tuple[np.ndarray, cl.Event]:
        """(planes?, H, W, channels?) on the host, valid after the event."""
        width, height = self.size
        shape = (self.planes,) * (self.planes > 1) + (height, width) + (self.channels,) * (self.channels > 1)
        out = np.empty(shape, self.dtype)
        return out, cl.enqueue_copy(queue, out, self.buffer, is_blocking=False)

    def read_block(
        self, queue: cl.CommandQueue, x: int, y: int, width=1, height=1
    ) -> tuple[np.ndarray, list[cl.Event]]:
        """(planes, height, width, channels) from pixel (x, y) on, all inside; valid after the events."""
        out = np.empty((self.planes, height, width, self.channels), self.dtype)
        pixel, events = out.itemsize * self.channels, []
        for plane in range(self.planes):
            for row in range(height):
                offset = ((plane * self.size[1] + y + row) * self.size[0] + x) * pixel
                events.append(
                    cl.enqueue_copy(queue, out[plane, row], self.buffer, src_offset=offset, is_blocking=False)
                )
        return out, events

    def place(self, px: tuple[int, int], source_px: tuple[float, float] | None) -> tuple[int, int] | None:
        """The pixel or texel that belongs to display pixel `px` and to `source_px`, a position in the rendered image;
        None where there is none."""
        if self.grid == "source" or self.grid.startswith("level"):
            if source_px is None:
                return None
            shift = int(self.grid[5:]) if self.grid.startswith("level") else 0
            x, y = (int(np.floor(c)) >> shift for c in source_px)
        else:
            shift = {"blocks": 5, "network": 1}.get(self.grid, 0)
            shift = int(self.grid[3:]) if self.grid.startswith("mip") else shift
            x, y = (c >> shift for c in px)
        return (x, y) if 0 <= x < self.size[0] and 0 <= y < self.size[1] else None


@dataclass(frozen=True)
class Story:
    """How a display pixel came about.

    Attributes
    ----------
    pixel : (int, int)
    filled_by : str
        Which stage its colour comes from.
    source : (float, float) or None
        Where the warp's motion points to, in pixels of the rendered image.
    trajectory : tuple of (float, float)
        Display pixels: the known positions P_i … P_1 and P_0 of its fragment as seen at the rendered frame, then where
        it is now.
    dynamic : bool or None
        None where no fragment of the rendered frame is shown.
    residual, threshold : float or None
        Pixels: how far its motion is from that of a static surface, and from where on it is dynamic.
    level : int or None
        Of the background that it was filled from.
    level_px : (float, float) or None
        Where that fragment lies in the rendered image, pixels.
    corrected : bool or None
        Whether shading correction changed its colour; None for rendered frames and where that is off.
    sentences : tuple of str
    """

    pixel: tuple[int, int]
    filled_by: str
    source: tuple[float, float] | None
    trajectory: tuple[tuple[float, float], ...] = ()
    dynamic: bool | None = None
    residual: float | None = None
    threshold: float | None = None
    level: int | None = None
    level_px: tuple[float, float] | None = None
    corrected: bool | None = None
    sentences: tuple[str, ...] = ()


def device_layers(pipeline: Pipeline, shot: Shot) -> dict[str, DeviceLayer]:
    """All images of the slot by the layers' names.

    At a rendered slot the stages after `submit` still hold the extrapolated frame before it.
    """
    source, target = pipeline.sizes.source, pipeline.sizes.target
    made = {
        "final": (np.float16, "source" if shot.whole else "target", source if shot.whole else target, 1, 4),
        "rendered.color": (np.float16, "source", source, 1, 4),
        "rendered.depth": (np.float32, "source", source, 1, 1),
        "rendered.motion": (np.float32, "source", source, 1, 2),
        "gae": (np.float16, "target", target, 1, 4),
        "truth": (np.float16, "target", target, 1, 4),
        "focus_truth": (np.uint8, "target", target, 1, 1),
    }
    layers = {name: DeviceLayer(shot.buffers[name], *made[name]) for name in made if name in shot.buffers}
    for stage, spec in pipeline.named_buffers():
        if spec.grid != "once":
            about = (spec.dtype, spec.grid, spec.size(pipeline.sizes), spec.planes, spec.channels)
            layers[f"{stage.name}.{spec.name}"] = DeviceLayer(stage.buffer[spec.name], *about)
    return layers


def read_layers(pipeline: Pipeline, layers: dict[str, DeviceLayer], names: Iterable[str]) -> dict[str, np.ndarray]:
    """Those of `names` that exist, each in an array of its own, with one wait for all."""
    read = {name: layers[name].read(pipeline.device.queue) for name in names if name in layers}
    if read:
        cl.wait_for_events([event for _, event in read.values()])
    return {name: array for name, (array, _) in read.items()}


def source_position(pipeline: Pipeline, shot: Shot, x: int, y: int) -> tuple[float, float] | None:
    """Where display pixel (x, y) comes from in the rendered image, pixels: the warp's motion, or the place on the
    display of a rendered frame. None if that is not finite."""
    if shot.whole:
        return tuple(
            (c + 0.5) * s / t for c, s, t in zip((x, y), pipeline.sizes.source, pipeline.sizes.target, strict=True)
        )
    if not shot.alpha:
        return _moved((x + 0.5, y + 0.5), shot.display_camera, shot.render_camera)
    motion = _blocks(pipeline, {"motion": (device_layers(pipeline, shot)["frame.motion"], x, y, 1, 1)})["motion"]
    at = motion.reshape(2) + (x + 0.5, y + 0.5)
    return tuple(map(float, at)) if np.isfinite(at).all() else None


def pixel_values(pipeline: Pipeline, shot: Shot, x: int, y: int) -> dict[str, np.ndarray]:
    """Values (planes?, channels) of all device layers at display pixel (x, y); rendered images and background levels
    where it comes from. Layers without a pixel there are left out."""
    source_px, layers = source_position(pipeline, shot, x, y), device_layers(pipeline, shot)
    places = {name: layer.place((x, y), source_px) for name, layer in layers.items()}
    read = _blocks(pipeline, {name: (layers[name], *at, 1, 1) for name, at in places.items() if at})
    return {name: array[0, 0, 0] if len(array) == 1 else array[:, 0, 0] for name, array in read.items()}


def pixel_story(pipeline: Pipeline, shot: Shot, x: int, y: int, values: dict[str, np.ndarray] | None = None) -> Story:
    """The story of display pixel (x, y), read from the pipeline's buffers; `values` may bring its `pixel_values`."""
    source_px = source_position(pipeline, shot, x, y)
    if not shot.alpha:
        told = _Fragment.at(pipeline, shot, source_px)
        start = f"Rendered frame {shot.k} as it is."
        return (
            told.story((x, y), "rendered frame", source_px, (start,))
            if told
            else Story((x, y), "rendered frame", source_px)
        )
    values = values or pixel_values(pipeline, shot, x, y)
    return _with_correction(_how_it_was_made(pipeline, shot, x, y, source_px, values), pipeline, values)


def _with_correction(story: Story, pipeline: Pipeline, values: dict[str, np.ndarray]) -> Story:
    if "correction" not in pipeline.stages:
        return story
    before, after = values["gae"][:3], values["final"][:3]
    if before.tobytes() == after.tobytes():
        return replace(story, corrected=False)
    mask = f"focus mask {float(values['correction.focus_mask'][0]):.2f}"
    if not pipeline.options.focus_mask:
        mask += ", which is off"
    colors = (f"({', '.join(f'{float(c):.4g}' for c in color)})" for color in (before, after))
    said = f"Shading correction changed it ({mask}): from {' to '.join(colors)}."
    return replace(story, corrected=True, sentences=(*story.sentences, said))


def _how_it_was_made(pipeline: Pipeline, shot: Shot, x: int, y: int, source_px, values) -> Story:
    number = int(values["frame.filled_by"][0])
    label = dict(FILLED_BY)[number]
    if number in (BY_HOLE_FILLING, BY_NOTHING):
        return Story((x, y), label, source_px, sentences=_hole_sentences(pipeline, shot, source_px))
    if 1 <= number < BY_CRACK_CLOSING and values["frame.disoccluded"][0]:
        return _background_story(pipeline, shot, (x, y), source_px, number - 1, values)
    told = _Fragment.at(pipeline, shot, source_px, ((x, y), number == 0, bool(values["frame.dynamic"][0])))
    where = f"({source_px[0]:.1f}, {source_px[1]:.1f}) of rendered frame {shot.k}" if source_px else "nowhere"
    start = [f"Shown by its own fragment, from {where}."]
    if number == BY_CRACK_CLOSING:
        start = [f"Crack closing: the fragment from {where} covers this pixel too, none lands in it."]
    elif number:
        start.append(
            f"Its colour is mixed with that of a silhouette there, so it comes from background level {number - 1}."
        )
    elif values["frame.mixed"][0]:
        start.append("Its colour is mixed with that of a silhouette there, so its neighbour's is shown.")
    if told is None:
        return Story((x, y), label, source_px, sentences=tuple(start))
    return told.story((x, y), label, source_px, tuple(start), number - 1 if 1 <= number < BY_CRACK_CLOSING else None)


@dataclass(frozen=True)
class _Fragment:
    """A fragment of the rendered frame: what history tracking and prediction know of it."""

    trajectory: tuple[tuple[float, float], ...]
    dynamic: bool
    residual: float | None
    threshold: float | None
    sentences: tuple[str, ...]

    def story(self, pixel, filled_by, source_px, start, level=None) -> Story:
        known = (self.trajectory, self.dynamic, self.residual, self.threshold)
        return Story(pixel, filled_by, source_px, *known, level, sentences=(*start, *self.sentences))

    @classmethod
    def at(cls, pipeline: Pipeline, shot: Shot, source_px, landed=None) -> _Fragment | None:
        """The fragment at `source_px`. `landed`: (display pixel, whether it lands in it, whether it is dynamic): then
        the one next to `source_px` that does. None out of the image."""
        layers = device_layers(pipeline, shot)
        at = layers["rendered.depth"].place((0, 0), source_px)
        if at is None:
            return None
        if landed:
            at = _fragment_that_landed(pipeline, layers, at, *landed)
        names = (
            "rendered.depth",
            "rendered.motion",
            "history.dynamic_mask",
            "history.history",
            "prediction.target_position",
        )
        values = _blocks(pipeline, {name: (layers[name], *at, 1, 1) for name in names})
        depth, motion, mask, history, target = (values[name].reshape(len(values[name]), -1) for name in names)
        depth, motion, dynamic = float(depth[0, 0]), motion[0].astype(np.float64), bool(mask[0, 0])
        px = np.add(at, 0.5)
        residual = _residual(shot, px, depth, motion) if pipeline.options.motion else None
        threshold = (
            None if residual is None else float(np.sqrt(pipeline.stages["history"].read("static_threshold_squared")[0]))
        )
        known = [place for place in history if dynamic and place[3] != 0]
        path = [_projected(place[:3], shot.display_camera) for place in known[::-1]]
        path.append(_moved(px, shot.render_camera, shot.display_camera))
        if shot.alpha and target[0, 2] > 0:
            path.append(tuple(map(float, target[0, :2])))
        used = min(len(known), pipeline.options.order) if shot.alpha else -1
        sentences = _fragment_sentences(pipeline, shot, depth, motion, dynamic, residual, threshold, used)
        return cls(tuple(point for point in path if point), dynamic, residual, threshold, sentences)


def _fragment_that_landed(pipeline, layers, at, pixel, inside: bool, dynamic: bool) -> tuple[int, int]:
    """The winner of a display pixel: within a pixel of where its motion points to; `at` if none fits."""
    x0, y0, width, height = _around(at, 1, layers["rendered.depth"].size)
    names = ("prediction.target_position", "history.dynamic_mask")
    block = _blocks(pipeline, {name: (layers[name], x0, y0, width, height) for name in names})
    place, mask = (block[name][0].reshape(width * height, -1) for name in names)
    fits = (place[:, 2] > 0) & (mask[:, 0] == dynamic)
    if inside:
        fits &= (np.floor(place[:, :2]) == pixel).all(1)
    distance = place[:, 2] if inside else np.hypot(*(place[:, :2] - np.add(pixel, 0.5)).T)
    best = _least(distance, fits)
    return at if best is None else (x0 + best % width, y0 + best // width)


def _residual(shot: Shot, px, depth: float, motion) -> float | None:
    """Pixels between where its motion says that the fragment was and where it was if static; None if not tested."""
    if shot.previous_camera is None or not (0 < depth < np.inf) or not np.isfinite(motion).all():
        return None
    was, z = shot.previous_camera.project(shot.render_camera.unproject(px, depth))
    return float(np.hypot(*(was - px - motion))) if z > 0 else None


def _fragment_sentences(pipeline, shot, depth, motion, dynamic, residual, threshold, used) -> tuple[str, ...]:
    if not depth > 0:
        return (f"Its depth ({depth:g}) is invalid, so nothing of it is splatted.",)
    if depth == np.inf:
        return ("Sky: it turns with the camera.",)
    if not pipeline.options.motion:
        return ("Motion estimation is off: everything counts as static.",)
    if shot.previous_camera is None:
        return ("No frame before this one is known: everything counts as static.",)
    if residual is None:
        why = "its motion is NaN or infinite" if not np.isfinite(motion).all() else "it was behind the camera before"
        return (f"Dynamic: {why}.",)
    kind, than = ("Dynamic", "more than") if dynamic else ("Static", "not more than")
    said = [
        f"{kind}: its motion is {residual:.2f} px from that of a surface that stands still,"
        f" {than} the threshold of {threshold:.2f} px."
    ]
    if dynamic and used == 0:
        said.append("No earlier position of it is known (hidden or out of the image then), so it stays where it is.")
    elif dynamic and used > 0:
        how = "linearly" if used == 1 else f"by a polynomial of order {used}"
        said.append(f"Predicted {how} from its last {used + 1} positions.")
    return tuple(said)


def _hole_sentences(pipeline: Pipeline, shot: Shot, source_px) -> tuple[str, ...]:
    nothing = f"No fragment of rendered frame {shot.k} lands here, nor one that the background remembers."
    if "background" not in pipeline.stages:
        nothing = f"No fragment of rendered frame {shot.k} lands here, and there is no background."
    if pipeline.options.hole_filling == "none":
        return nothing, "Hole filling is off: black, at infinite depth."
    said = [nothing, f"Hole filling: its colour {FILLINGS[pipeline.options.hole_filling].sentence}."]
    if source_px and not all(0 <= c < s for c, s in zip(source_px, pipeline.sizes.source, strict=True)):
        said.append(f"It lies outside the rendered image, at ({source_px[0]:.1f}, {source_px[1]:.1f}).")
    return tuple(said)


def _background_story(pipeline, shot, pixel, source_px, level: int, values) -> Story:
    depth = float(values["frame.depth"][0])
    at = _remembered(pipeline, shot, pixel, source_px, level, depth)
    lies = f", last at ({at[0]:.1f}, {at[1]:.1f}) of the rendered image" if at else ""
    said = [f"Filled from background level {level}: a static surface hidden now{lies}."]
    if "rendered.depth" in values:
        front = float(values["rendered.depth"][0])
        said.append(f"At that place rendered frame {shot.k} shows depth {front:.4g}; the depth here is {depth:.4g}.")
    now = (pixel[0] + 0.5, pixel[1] + 0.5)
    path = (_moved(at, shot.render_camera, shot.display_camera), now) if at else (now,)
    return Story(pixel, dict(FILLED_BY)[1 + level], source_px, path, level=level, level_px=at, sentences=tuple(said))


def _remembered(pipeline, shot, pixel, source_px, level: int, depth: float) -> tuple[float, float] | None:
    """Where the remembered fragment lies that is shown at `pixel`, at `depth` there: pixels of the rendered image."""
    layers = {name: layer for name, layer in device_layers(pipeline, shot).items() if name.startswith("background.")}
    names = [f"background.{name}_{level}" for name in ("state", "depth", "px")]
    at = source_px and layers[names[0]].place(pixel, source_px)
    if not at:
        return None
    x0, y0, width, height = _around(at, 2, layers[names[0]].size)
    block = _blocks(pipeline, {name: (layers[name], x0, y0, width, height) for name in names})
    state, z, px = (block[name][0].reshape(width * height, -1) for name in names)
    fits = state[:, 0] == _REMEMBERED
    if np.isfinite(depth):
        world = shot.camera.unproject(np.add(pixel, 0.5), depth)
        expected = float(shot.render_camera.project(world)[1])
        fits &= np.abs(z[:, 0] - expected) <= _SAME_SURFACE * expected
    else:
        fits &= np.isinf(z[:, 0])
    best = _least(np.hypot(*(px.astype(np.float64) - source_px).T), fits)
    return None if best is None else tuple(map(float, px[best]))


def _least(values: np.ndarray, fits: np.ndarray) -> int | None:
    """Index of the least of `values` (N,), infinite ones too, where `fits` (N,)."""
    candidates = np.flatnonzero(fits)
    return int(candidates[np.argmin(values[candidates])]) if candidates.size else None


def _blocks(pipeline: Pipeline, wanted: dict[str, tuple]) -> dict[str, np.ndarray]:
    """`DeviceLayer.read_block` of (layer, x, y, width, height) each, with one wait for all."""
    read = {name: layer.read_block(pipeline.device.queue, *where) for name, (layer, *where) in wanted.items()}
    events = [event for _, these in read.values() for event in these]
    if events:
        cl.wait_for_events(events)
    return {name: array for name, (array, _) in read.items()}


def _around(at, reach: int, size) -> tuple[int, int, int, int]:
    """x, y, width, height of the block up to `reach` around `at`, within an image of `size`."""
    low = [max(c - reach, 0) for c in at]
    return (*low, *(min(c + reach + 1, s) - first for c, s, first in zip(at, size, low, strict=True)))


def _moved(px, image: Camera, other: Camera) -> tuple[float, float]:
    """The position in `other`'s image of position `px` in `image`'s; both have one pose."""
    return (
        float((px[0] - image.cx) * other.fx / image.fx + other.cx),
        float((px[1] - image.cy) * other.fy / image.fy + other.cy),
    )


def _projected(view_pos, camera: Camera) -> tuple[float, float] | None:
    """Display pixels of a position in view space; None behind the camera."""
    x, y, z = map(float, view_pos)
    return (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy) if z > 0 else None
