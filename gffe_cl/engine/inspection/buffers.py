"""Device buffers of one slot: whole layers, and the values at a pixel."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import FRAME_BUFFERS, named_images
from gffe_cl.engine.opencl.program import build
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.buffers import BufferSpec, grid_of, spread, texels_over

_Key = TypeVar("_Key")


@dataclass(frozen=True)
class Moment:
    """Moment of a slot: its time and cameras.

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
    """

    k: int
    alpha: float
    time: float
    camera: Camera
    render_camera: Camera
    display_camera: Camera
    previous_camera: Camera | None


@dataclass(frozen=True)
class Shot:
    """A moment that a pipeline's buffers hold; `buffers` are those of the frame's own layers that there are: for a
    rendered slot also "truth", the display part."""

    moment: Moment
    buffers: dict[str, cl.Buffer]


@dataclass(frozen=True)
class DeviceLayer:
    """An image in a device buffer, described by `spec`; `size`: (width, height); `known`: the layer that marks its
    valid places, see `BufferSpec`; `scale`: pixels of it for one of the grid, where it is smaller than that."""

    buffer: cl.Buffer
    spec: BufferSpec
    size: tuple[int, int]
    known: DeviceLayer | None = None
    scale: tuple[float, float] = (1.0, 1.0)

    def read(self, queue: cl.CommandQueue) -> tuple[np.ndarray, cl.Event]:
        """Return the stored values, (planes?, H, W, channels), on the host, valid after the event."""
        stored, flat = self.spec.host_array(self.size)
        return stored, cl.enqueue_copy(queue, flat, self.buffer, is_blocking=False)

    def read_block(
        self, queue: cl.CommandQueue, x: int, y: int, width=1, height=1
    ) -> tuple[np.ndarray, list[cl.Event]]:
        """Return the stored values, (planes, height, width, channels), from pixel (x, y) on, all inside; valid after
        the events."""
        planes, channels = self.spec.planes, self.spec.stored_channels
        if self.spec.planar:
            planes, channels = channels, 1
        out = np.empty((planes, height, width, channels), self.spec.stored_dtype)
        pixel, events = out.itemsize * channels, []
        for plane in range(planes):
            for row in range(height):
                offset = ((plane * self.size[1] + y + row) * self.size[0] + x) * pixel
                events.append(
                    cl.enqueue_copy(queue, out[plane, row], self.buffer, src_offset=offset, is_blocking=False)
                )
        return (out[..., 0].transpose(1, 2, 0)[None] if self.spec.planar else out), events

    def read_known(
        self, queue: cl.CommandQueue, x=0, y=0, width=0, height=0
    ) -> tuple[Callable[[], np.ndarray | None], list[cl.Event]]:
        """Return the function that gives `BufferSpec.values` its `known` for a block, by default the whole layer, after
        the events."""
        if self.known is None:
            return lambda: None, []
        block = x, y, width or self.size[0], height or self.size[1]
        grids = self.known.spec.grid, self.spec.grid
        stored, events = self.known.read_block(queue, *texels_over(*grids, *block))
        return lambda: spread(stored[0, ..., 0], *grids, *block), events

    def place(self, px: tuple[int, int], source_px: Sequence[float] | np.ndarray | None) -> tuple[int, int] | None:
        """Return the pixel or texel for display pixel `px` and for `source_px`, a position in the rendered image;
        None if there is none."""
        if grid_of(self.spec.grid).lies_on_source:
            if source_px is None:
                return None
            px = int(np.floor(source_px[0] * self.scale[0])), int(np.floor(source_px[1] * self.scale[1]))
        x, y = (c // side for c, side in zip(px, grid_of(self.spec.grid).texel, strict=True))
        return (x, y) if 0 <= x < self.size[0] and 0 <= y < self.size[1] else None


def device_layers(pipeline: Pipeline, shot: Shot) -> dict[str, DeviceLayer]:
    """Return all images of the slot by the layers' names. A rendered slot has none of those that are made for generated
    frames only: their buffers hold another slot's, or nothing."""
    generated = shot.moment.alpha > 0
    images = {name: (FRAME_BUFFERS[name], buffer) for name, buffer in shot.buffers.items()}
    images |= named_images(pipeline, generated)
    source = pipeline.sizes.source
    own_sizes = {f"{owner.name}.{spec.name}": size for owner, spec, size in pipeline.conversions()}
    layers = {
        name: DeviceLayer(buffer, spec, own_sizes.get(name) or spec.size(pipeline.sizes))
        for name, (spec, buffer) in images.items()
        if generated or not spec.transient or name in own_sizes
    }
    for name, (width, height) in own_sizes.items():
        layers[name] = replace(layers[name], scale=(width / source[0], height / source[1]))
    for name, layer in layers.items():
        if layer.spec.known_where:
            known = layers[f"{name.partition('.')[0]}.{layer.spec.known_where[0]}"]
            layers[name] = replace(layer, known=known)
    return layers


def read_layers(pipeline: Pipeline, layers: dict[str, DeviceLayer], wanted: Iterable[str]) -> dict[str, np.ndarray]:
    """Return those of `wanted` that exist, each (planes?, H, W, channels?) in an array of its own, with one wait for
    all."""
    queue = pipeline.device.queue
    layers = {name: layers[name] for name in wanted if name in layers}
    read = {name: layer.read(queue) for name, layer in layers.items()}
    known = {name: layer.read_known(queue) for name, layer in layers.items()}
    if events := [event for _, event in read.values()] + [e for _, waited in known.values() for e in waited]:
        cl.wait_for_events(events)
    values = {}
    for name, (stored, _) in read.items():
        spec = layers[name].spec
        found = spec.values(stored, known[name][0]())
        values[name] = found if spec.channels > 1 else found[..., 0]
    return values


def source_position(pipeline: Pipeline, shot: Shot, x: int, y: int) -> tuple[float, float] | None:
    """Return the position in the rendered image, in pixels, that display pixel (x, y) comes from: by the warp's motion,
    or by the place on the display of a rendered frame. None if that is not finite."""
    if not shot.moment.alpha:
        return moved((x + 0.5, y + 0.5), shot.moment.display_camera, shot.moment.render_camera)
    motion = read_blocks(pipeline, {"motion": (device_layers(pipeline, shot)[names.MOTION], x, y, 1, 1)})["motion"]
    at = motion.reshape(2) + (x + 0.5, y + 0.5)
    return (float(at[0]), float(at[1])) if np.isfinite(at).all() else None


class PixelValues(NamedTuple):
    """Values (planes?, channels) by layer: of all layers `here`, at the display pixel; of layers on the rendered image
    also at the pixel's `origin`, the position that its content comes from, where that is another one. Layers without a
    pixel there are left out. `moving`: layers whose values at the origin are others."""

    here: dict[str, np.ndarray]
    origin: dict[str, np.ndarray]
    moving: frozenset[str]

    @property
    def of_content(self) -> dict[str, np.ndarray]:
        """The values that the pixel's content was made from."""
        return {name: value for name, value in self.here.items() if name not in self.moving} | self.origin


def pixel_values(pipeline: Pipeline, shot: Shot, x: int, y: int) -> PixelValues:
    """Return the values of all device layers at display pixel (x, y): those that the picture shows there, and those
    that it was made from."""
    moment, layers = shot.moment, device_layers(pipeline, shot)
    shown = moved((x + 0.5, y + 0.5), moment.display_camera, moment.render_camera)
    places = {("here", name): layer.place((x, y), shown) for name, layer in layers.items()}
    of_rendered = (name for name, layer in layers.items() if grid_of(layer.spec.grid).lies_on_source)
    moving = frozenset(of_rendered if moment.alpha else ())
    source_px = source_position(pipeline, shot, x, y) if moving else None
    places |= {("origin", name): layers[name].place((x, y), source_px) for name in moving}
    read = read_blocks(pipeline, {key: (layers[key[1]], *at, 1, 1) for key, at in places.items() if at})
    values = PixelValues({}, {}, moving)
    for (where, name), array in read.items():
        getattr(values, where)[name] = array[0, 0, 0] if len(array) == 1 else array[:, 0, 0]
    return values


def read_blocks(pipeline: Pipeline, wanted: dict[_Key, tuple]) -> dict[_Key, np.ndarray]:
    """Return the values (planes, height, width, channels) of each block (layer, x, y, width, height), with one wait for
    all."""
    queue = pipeline.device.queue
    read = {name: layer.read_block(queue, *where) for name, (layer, *where) in wanted.items()}
    known = {name: layer.read_known(queue, *where) for name, (layer, *where) in wanted.items()}
    events = [event for _, these in (*read.values(), *known.values()) for event in these]
    if events:
        cl.wait_for_events(events)
    values = {}
    for name, (stored, _) in read.items():
        layer, x, y, *_ = wanted[name]
        values[name] = layer.spec.values(stored, known[name][0](), x, y)
    return values


def moved(px, image: Camera, other: Camera) -> tuple[float, float]:
    """Return the position in `other`'s image of position `px` in `image`'s; both cameras have one pose."""
    return (
        float((px[0] - image.cx) * other.fx / image.fx + other.cx),
        float((px[1] - image.cy) * other.fy / image.fy + other.cy),
    )


def told(pipeline: Pipeline, stage: str, of: str, slot: str, numbers: int, **given: int) -> np.ndarray:
    """Return the `numbers` (float32) that kernel "tell_<stage>" of `kernels/stories/<stage>.cl` tells from the buffers
    of the stage's kernel `of` and the frame block `slot`; `given`: its other arguments."""
    owner, device = pipeline.stages[stage], pipeline.device
    program = build(device, f"stories/{owner.program.name}")
    out = np.zeros(numbers, np.float32)
    buffer = cl.Buffer(device.context, cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR, hostbuf=out)
    declared = next(one for one in owner.kernels if one.name == of)
    values = owner.values(declared, slot, {**given, "told": buffer})
    group = owner.program.constants[declared.group] if declared.grid == "walk" else 1
    program.launch(device.queue, f"tell_{stage}", (group,), (group,), values)
    cl.enqueue_copy(device.queue, out, buffer)
    return out


def least(values: np.ndarray, fits: np.ndarray) -> int | None:
    """Return the index of the least of `values` (N,), infinite ones too, where `fits` (N,); None if that is nowhere."""
    candidates = np.flatnonzero(fits)
    return int(candidates[np.argmin(values[candidates])]) if candidates.size else None


def around(at, reach: int, size) -> tuple[int, int, int, int]:
    """Return x, y, width, height of the block up to `reach` around `at`, within an image of `size`."""
    x, y = (max(c - reach, 0) for c in at)
    return x, y, min(at[0] + reach + 1, size[0]) - x, min(at[1] + reach + 1, size[1]) - y
