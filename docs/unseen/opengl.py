"""OpenGL by moderngl, offscreen: targets to draw into, textures with detail, reading back, supersampled scenes."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod

import moderngl
import numpy as np

import gffe_cl as gffe
from unseen.recording import Picture, with_sky


def offscreen_context() -> moderngl.Context:
    """Return a context without a window: EGL where there is no display."""
    for backend in ({"backend": "egl"}, {}):
        with contextlib.suppress(Exception):  # whatever the platform's library raises
            return moderngl.create_context(standalone=True, require=330, **backend)
    raise SystemExit("error: no OpenGL 3.3 (expected EGL or a display; Mesa's software renderer will do)")


class Target:
    """A framebuffer of float colors with depth.

    Parameters
    ----------
    width, height : int
        Pixels.
    outputs : int
        How many images of four channels.
    """

    def __init__(self, context: moderngl.Context, width: int, height: int, outputs: int = 1):
        self.width, self.height = width, height
        images = [context.texture((width, height), 4, dtype="f4") for _ in range(outputs)]
        self.framebuffer = context.framebuffer(images, context.depth_renderbuffer((width, height)))

    def clear(self) -> None:
        """Set all to 0 and the depth to the far plane; drawing goes here from now on."""
        self.framebuffer.use()
        self.framebuffer.clear(0, 0, 0, 0)

    def read(self, output: int = 0) -> np.ndarray:
        """Return (H, W, 4) float32, top row first."""
        data = self.framebuffer.read(components=4, attachment=output, dtype="f4")
        return np.frombuffer(data, np.float32).reshape(self.height, self.width, 4)[::-1]


def mean_of_blocks(image: np.ndarray, side: int) -> np.ndarray:
    """Return the image `side` times smaller: means of square blocks."""
    height, width, channels = image.shape
    return image.reshape(height // side, side, width // side, side, channels).mean((1, 3))


def repeating_texture(context: moderngl.Context, values: np.ndarray) -> moderngl.Texture:
    """Return a mipmapped texture of (H, W, C) values within 0 … 1."""
    height, width, channels = values.shape
    data = np.ascontiguousarray(np.round(255 * np.clip(values, 0, 1)).astype(np.uint8))
    texture = context.texture((width, height), channels, data)
    texture.build_mipmaps()
    texture.anisotropy = 8
    return texture


def matrix_bytes(matrix: np.ndarray) -> bytes:
    """Return a matrix of column vectors as a uniform takes it."""
    return np.ascontiguousarray(np.asarray(matrix).T, np.float32).tobytes()


def array_bytes(array: np.ndarray) -> bytes:
    """Return values as 32-bit floats."""
    return np.ascontiguousarray(array, np.float32).tobytes()


class SupersampledScene(ABC):
    """A generator whose colors are means of samples, while depth and motion are those of centers of pixels.

    Parameters
    ----------
    width, height : int
        Pixels of a picture.
    frames : int
        How many pictures are rendered.
    samples : int
        How many samples of color a pixel has in each direction.
    outputs : int
        How many images a program draws; the last one has depth and motion.
    """

    def __init__(self, width: int, height: int, frames: int, samples: int, outputs: int = 2):
        self.width, self.height, self.frames = width, height, frames
        self._context, self._samples = offscreen_context(), samples
        self._targets = [Target(self._context, width * k, height * k, outputs) for k in (samples, 1)]
        self._last = outputs - 1

    @abstractmethod
    def camera(self, time: float) -> gffe.Camera:
        """Return the camera at `time` (seconds)."""

    @abstractmethod
    def draw(self, target: Target, camera: gffe.Camera, before: gffe.Camera, now: float, earlier: float) -> None:
        """Draw into `target` what `camera` sees `now` (seconds); `before` is the camera of `earlier`."""

    def shown(self, samples: np.ndarray) -> np.ndarray:
        """Return colors (H, W, 3) of drawn samples (H, W, 4)."""
        return np.clip(samples[..., :3], 0, 8)

    def picture(self, time: float, previous: float | None) -> Picture:
        """Return the picture at `time` (seconds), with motion since `previous`."""
        earlier = time if previous is None else previous
        camera, before = self.camera(time), self.camera(earlier)
        for target, scale in zip(self._targets, (self._samples, 1), strict=True):
            target.clear()
            self.draw(target, camera.scaled(scale, scale), before, time, earlier)
        color = mean_of_blocks(self.shown(self._targets[0].read()), self._samples)
        found = self._targets[1].read(self._last)
        depth, motion = with_sky(found[..., 0], found[..., 1:3], camera, None if previous is None else before)
        return Picture(color, depth, motion, camera)

    def close(self) -> None:
        """Release the context."""
        self._context.release()
