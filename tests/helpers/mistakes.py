"""Mistakes of live integrations, made in good frames: what the doctor names, and what a format to paste undoes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from fault_injection import BREAKS, GAPS, NEAR

from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.engine.frame.camera import Camera

FAR = 1000.0


@dataclass(frozen=True)
class Mistake:
    """`change` of good frames, the `names` of the findings, and how exactly the found format undoes it: None if none
    does, 0 to the bit, else relative to depths and in pixels."""

    change: Callable
    names: tuple[str, ...]
    off: float | None = 0.0


def of_another_frame(field, by):
    """Return a change: each frame has the `field` of the frame `by` before it."""

    def change(frames):
        sources = np.clip(np.arange(len(frames)) - by, 0, len(frames) - 1)
        shown = {"display_camera": None} if field == "camera" else {}
        return [replace(f, **{field: getattr(frames[k], field)}, **shown) for f, k in zip(frames, sources, strict=True)]

    return change


def motion(factor):
    """Return a change of vectors by `factor` of the size of the image."""

    def change(frames):
        height, width = frames[0].depth.shape
        scale = np.asarray(factor((width, height)), np.float32)
        return [replace(f, motion=None if f.motion is None else f.motion * scale) for f in frames]

    return change


def depth(law):
    def change(frames):
        with np.errstate(all="ignore"):
            return [replace(f, depth=law(f.depth.astype(np.float64), f).astype(np.float32)) for f in frames]

    return change


def camera(matrix=lambda m: m, focal=1.0):
    def change(frames):
        made = []
        for f in frames:
            c = f.camera
            one = Camera(matrix(c.world_to_view.copy()), c.fx * focal, c.fy * focal, c.cx, c.cy)
            made.append(replace(f, camera=one, display_camera=None))
        return made

    return change


def position_in_matrix(m):
    m[:3, 3] = -m[:3, :3].T @ m[:3, 3]
    return m


def rows_up(frames):
    return [
        replace(f, color=f.color[::-1], depth=f.depth[::-1], motion=None if f.motion is None else f.motion[::-1])
        for f in frames
    ]


def srgb(frames):
    """Return frames of display values; silhouettes are antialiased, textures in between are flat."""
    made = []
    for f in frames:
        linear = np.clip(f.color.astype(np.float32), 0, 1)
        curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
        made.append(replace(f, color=curve.astype(np.float32)))
    return made


def encoded(text):
    return lambda frames: [Encoding.parse(text).frame(frame) for frame in frames]


def repeated_geometry(frames):
    def twice(image):
        return None if image is None else np.repeat(np.repeat(image[::2, ::2], 2, 0), 2, 1)

    return [replace(f, depth=twice(f.depth), motion=twice(f.motion)) for f in frames]


def motion_grid(frames):
    return [replace(f, motion=None if f.motion is None else np.round(f.motion * 4) / 4) for f in frames]


def unwritten(frames):
    rng = np.random.default_rng(1)

    def some(v):
        return np.where((rng.random(v.shape[:2]) < 0.02)[..., None], np.float32(4096), v)

    return [replace(f, motion=None if f.motion is None else some(f.motion)) for f in frames]


def with_nan(frames):
    color = np.array(frames[2].color)
    color[5, 7] = np.nan
    return [*frames[:2], replace(frames[2], color=color), *frames[3:]]


def recorded_twice(frames):
    made = [frame for k, frame in enumerate(frames) for _ in range(1 + (k == 3))]
    return [replace(f, time=k / 30, reset=k == 0) for k, f in enumerate(made)]


def rendered_at_half_the_rate(frames):
    """Return each frame twice, the second time without motion and with the noise of an encoder."""
    made = []
    for f in frames[: len(frames) // 2]:
        copy = replace(f, motion=np.zeros((*f.depth.shape, 2), np.float32), color=f.color + np.float16(1e-3))
        made += [f, copy]
    return [replace(f, time=k / 30, reset=k == 0) for k, f in enumerate(made)]


def every_second_reset(frames):
    return [replace(f, reset=k % 2 == 0) for k, f in enumerate(frames)]


def color_twice(frames):
    return [replace(f, color=frames[k - (k == 3)].color) for k, f in enumerate(frames)]


def flipped_once(frames):
    return [replace(f, motion=f.motion * np.float32((-1, 1))) if k == 4 else f for k, f in enumerate(frames)]


def cut(frames):
    """Return frames of which the later ones show another place: the picture and its camera are turned round."""
    made = []
    for k, f in enumerate(frames):
        flipped = {name: np.ascontiguousarray(getattr(f, name)[:, ::-1]) for name in ("color", "depth")}
        vectors = np.zeros_like(f.motion) if k == 4 else f.motion[:, ::-1] * np.float32((-1, 1)) if k > 4 else None
        turned = camera(lambda m: np.diag([-1.0, 1, 1, 1]) @ m)([f])[0].camera
        c = replace(turned, cx=f.depth.shape[1] - turned.cx)
        made.append(replace(f, **flipped, motion=vectors, camera=c, display_camera=None) if k > 3 else f)
    return made


def broken_by(name):
    return BREAKS[name][1]


def logarithm(near, far):
    return lambda z, f: np.where(np.isinf(z), 1, np.log(z / near) / np.log(far / near))


def logarithm_of_more(far):
    return lambda z, f: np.where(np.isinf(z), 1, np.log1p(z) / np.log1p(far))


def along_rays(z, frame):
    height, width = z.shape
    y, x = np.mgrid[:height, :width] + 0.5
    c = frame.camera
    return z * np.sqrt(1 + ((x - c.cx) / c.fx) ** 2 + ((y - c.cy) / c.fy) ** 2)


OPENGL, Y_UP = np.diag([1.0, -1, -1, 1]), np.diag([1.0, -1, 1, 1])
MISTAKES = {
    "from previous": Mistake(motion(lambda s: (-1, -1)), ("motion-direction",)),
    "y up": Mistake(motion(lambda s: (1, -1)), ("motion-y",)),
    "uv": Mistake(motion(lambda s: 1 / np.array(s)), ("motion-unit",)),
    "ndc": Mistake(motion(lambda s: 2 / np.array(s)), ("motion-unit",)),
    "as of Unity": Mistake(motion(lambda s: (-1, 1) / np.array(s)), ("motion-direction", "motion-y", "motion-unit")),
    "twice": Mistake(motion(lambda s: (2, 2)), ("motion-scale",)),
    "half": Mistake(motion(lambda s: (0.5, 0.5)), ("motion-scale",)),
    "to the next frame": Mistake(broken_by("motion to the next frame"), ("motion-to-next",), None),
    "without the camera": Mistake(broken_by("motion without the camera"), ("camera-motion",), 1e-2),
    "zero": Mistake(motion(lambda s: (0, 0)), ("camera-motion",), 1e-2),
    "device": Mistake(depth(lambda z, f: 1 - NEAR / z), ("depth",), 2e-2),
    "reversed": Mistake(depth(lambda z, f: NEAR / z), ("depth",), 2e-2),
    "logarithmic": Mistake(depth(logarithm(NEAR, FAR)), ("depth",), 2e-2),
    "logarithmic of 1 + z": Mistake(depth(logarithm_of_more(FAR)), ("depth",), 2e-2),
    "distance": Mistake(depth(along_rays), ("depth",), 1e-4),
    "centimeters": Mistake(depth(lambda z, f: 100 * z), ("depth-scale",), 1e-4),
    "OpenGL axes": Mistake(camera(lambda m: OPENGL @ m), ("camera",), 1e-6),
    "y-up axes": Mistake(camera(lambda m: Y_UP @ m), ("camera",), 1e-6),
    "inverted": Mistake(camera(np.linalg.inv), ("camera",), 1e-6),
    "rotation transposed": Mistake(broken_by("camera transposed"), ("camera",), 1e-6),
    "position": Mistake(camera(position_in_matrix), ("camera",), 1e-6),
    "field of view": Mistake(camera(focal=1.2), ("camera",), 1e-2),
    "rows up": Mistake(rows_up, ("rows",)),
    "vectors of the frame before": Mistake(of_another_frame("motion", 1), ("other-frame",)),
    "vectors of the frame after": Mistake(of_another_frame("motion", -1), ("other-frame",)),
    "camera of the frame before": Mistake(of_another_frame("camera", 1), ("other-frame",)),
    "camera of the frame after": Mistake(of_another_frame("camera", -1), ("other-frame",)),
    "depth of the frame before": Mistake(of_another_frame("depth", 1), ("other-frame",)),
    "color of the frame before": Mistake(of_another_frame("color", 1), ("other-frame",)),
    "color of the frame after": Mistake(of_another_frame("color", -1), ("other-frame",)),
    "display values": Mistake(srgb, ("color-encoding",), None),
    "color rows": Mistake(broken_by("color rows"), ("color-rows",), None),
    "jitter": Mistake(broken_by("motion jitter not removed"), ("jitter",), None),
    "x of one frame": Mistake(flipped_once, ("flipped-frame",), None),
    "frame dropped": Mistake(GAPS["frame dropped"], ("gap",), None),
    "recorded twice": Mistake(recorded_twice, ("repeated-frames",), None),
    "at half the rate": Mistake(rendered_at_half_the_rate, ("repeated-frames",), None),
    "reset in every second frame": Mistake(every_second_reset, ("needless-resets",), None),
    "color twice": Mistake(color_twice, ("repeated-color",), None),
    "cut": Mistake(cut, ("cut",), None),
    # Notes.
    "never written": Mistake(unwritten, ("motion-never-written",), None),
    "quantized": Mistake(motion_grid, ("motion-quantized",), None),
    "half depth": Mistake(encoded("half-depth"), ("few-bits",), None),
    "8 bits": Mistake(encoded("8bit-color"), ("few-bits",), None),
    "dilated": Mistake(encoded("dilated"), ("motion-dilated",), None),
    "repeated pixels": Mistake(repeated_geometry, ("repeated-pixels", "repeated-pixels"), None),
    "not a number": Mistake(with_nan, ("bad-pixels",), None),
}


def sides_swapped(frames):
    return [replace(f, motion=None if f.motion is None else f.motion[..., ::-1]) for f in frames]


def bytes_lost(frames):
    """Return frames whose vectors lack the first byte, so that no number is where it was."""

    def shifted(v):
        return np.frombuffer(np.float32(v).tobytes()[1:] + bytes(1), np.float32).reshape(v.shape)

    return [replace(f, motion=None if f.motion is None else shifted(f.motion)) for f in frames]


def two_views(frames):
    """Return frames whose right half shows what another camera sees: the left half again, moving backwards."""
    made = []
    for k, f in enumerate(frames):
        other, half = frames[len(frames) - 1 - k], f.depth.shape[1] // 2
        after = frames[min(len(frames) - k, len(frames) - 1)]
        parts = {"color": np.array(f.color), "depth": np.array(f.depth)}
        for name, image in parts.items():
            image[:, half:] = getattr(other, name)[:, :half]
        vectors = None
        if f.motion is not None:
            vectors = np.array(f.motion)
            vectors[:, half:] = 0 if after.motion is None else -after.motion[:, :half]
        made.append(replace(f, **parts, motion=vectors))
    return made


def views_of_one_scene(frames):
    """Return frames whose right half is that of the frame three later, or of the first ones."""
    made, half = [], frames[0].depth.shape[1] // 2
    for k, f in enumerate(frames):
        other, parts = frames[(k + 3) % len(frames)], {}
        for name in ("color", "depth", "motion"):
            here, there = (
                np.zeros((*f.depth.shape, 2)) if (a := getattr(one, name)) is None else a for one in (f, other)
            )
            parts[name] = np.concatenate([here[:, :half], there[:, half:]], 1).astype(here.dtype)
        made.append(replace(f, **parts))
    return made


def origin_shifted(frames):
    def moved(k, f):
        m = f.camera.world_to_view.copy()
        m[:3, 3] += m[:3, :3] @ (40.0, 0, -15)
        return replace(f, camera=replace(f.camera, world_to_view=m), display_camera=None) if k > 3 else f

    return [moved(k, f) for k, f in enumerate(frames)]


def oblique(z, frame):
    """Return device depth of a near plane that leans: it depends on the pixel, too."""
    x = np.linspace(-1, 1, z.shape[1])
    return np.where(np.isinf(z), 1, 1 - (NEAR / z) * (1 + 0.6 * x))


bits_of_floats = depth(lambda z, f: z.astype(np.float32).view(np.uint32) / 2**32)

# By name: changes that no format undoes. They must not get another name.
UNEXPLAINED = {
    "square root of depth": depth(lambda z, f: np.where(np.isinf(z), z, np.sqrt(z / 100))),
    "saturated depth": depth(lambda z, f: np.minimum(z, np.quantile(z[np.isfinite(z)], 0.45))),
    "split screen": two_views,
    "origin shifted": origin_shifted,
    "oblique near plane": depth(oblique),
    "x and y swapped": sides_swapped,
    "lost bytes": bytes_lost,
}
