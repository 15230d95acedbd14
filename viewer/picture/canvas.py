"""Drawing layers with OpenGL: one shader does it all, in as many variants as are needed.

Row 0 of an array is the top of the picture, row 0 of a layer's texture, and the first row in memory of the texture that
`Canvas.draw` returns: uv (0, 0), which is the upper left corner in Dear ImGui. Nothing is flipped anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import VIEWS, LayerSpec
from . import displays
from .displays import TONE_MAPS, Display, FrameInfo, Rgb, shown_as
from .view import CLIPPING, COMPARISONS, DIFFERENCES, OVERLAYS, Size, View, compared_as, full_scale

_OF_LAYER = ("VIEW", "SMOOTH", "CHANNEL", "TONE_MAP", "WEIGHTED", "WHOLE")
# of display.frag
_VARIANT = (*(f"{name}_{side}" for side in "AB" for name in _OF_LAYER), "COMPARE", "OVERLAY", "GRID")
_GRID = (8.0, 24.0)  # screen pixels per texel and display pixel: lines between them show, and are as clear as they get
_SAMPLERS = ("texels_a", "texels_b", "rendered_depth", "color_maps")
_UNITS = {name: unit for unit, name in enumerate(_SAMPLERS)}


@dataclass(frozen=True)
class Tile:
    """Place of a layer in an overview: a rectangle in the overview's pixels, from the upper left corner."""

    name: str
    x: int
    y: int
    width: int
    height: int


_DTYPES = {"uint8": "f1", "float16": "f2", "float32": "f4"}


class Texture:
    """A layer on the GPU: (planes, H, W, components) texels."""

    def __init__(self, ctx: moderngl.Context, texels: np.ndarray):
        planes, height, width, self.components = texels.shape
        self.size, self.format = (width, height), (texels.shape, texels.dtype)
        dtype = _DTYPES[texels.dtype.name]
        self.texels = ctx.texture_array((width, height, planes), self.components, alignment=1, dtype=dtype)
        self.texels.repeat_x = self.texels.repeat_y = False
        self.texels.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self.planes, self.unit = planes, 255.0 if dtype == "f1" else 1.0
        self.mipmaps = 0  # levels of the present texels, besides themselves
        self.spec: LayerSpec | None = None
        self.frame: FrameInfo | None = None

    def release(self) -> None:
        self.texels.release()

    def have_mipmaps(self, levels: int) -> None:
        """Make at least this many mipmaps for smaller display, with interpolation between two of them."""
        if levels > self.mipmaps:
            self.texels.build_mipmaps(max_level=levels)
            self.texels.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            self.mipmaps = levels


def texels_of(array: np.ndarray, spec: LayerSpec, most: int) -> np.ndarray | None:
    """Return (planes, H, W, C) of one of _DTYPES, C-contiguous; None for an empty image."""
    array = np.asarray(array)
    if spec.planes == 1 and array.ndim < 4:
        array = array[None]
    array = array[..., None] if array.ndim == 3 else array[..., :4]
    if array.ndim != 4 or not array.size:
        return None
    step = math.ceil(max(array.shape[1:3]) / most)
    array = array[:, ::step, ::step]
    return np.ascontiguousarray(array, array.dtype if array.dtype.name in _DTYPES else np.float32)


@dataclass(frozen=True)
class _Shown:
    """A layer as the shader takes it; `variant`: its _OF_LAYER."""

    texture: Texture
    variant: tuple[int, ...]
    uniforms: dict[str, Any]


class _Program:
    """The shader for one choice of _VARIANT."""

    def __init__(self, ctx: moderngl.Context, choice: tuple[int, ...]):
        vertex, fragment = (Path(__file__).with_name(f"display.{kind}").read_text("utf-8") for kind in ("vert", "frag"))
        version, rest = fragment.split("\n", 1)
        macros = (f"#define {name} {value}" for name, value in zip(_VARIANT, choice, strict=True))
        fragment = "\n".join((version, *_constants(), *macros, "#line 2", rest))
        self._program = ctx.program(vertex_shader=vertex, fragment_shader=fragment)
        self._uniforms = {name: self._program[name] for name in self._program}
        self.triangle = ctx.vertex_array(self._program, [])
        self.set("", _UNITS)

    def set(self, prefix: str, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            uniform: Any = self._uniforms.get(prefix + name)
            if uniform is not None:  # this variant may do without
                uniform.value = value

    def release(self) -> None:
        self.triangle.release()
        self._program.release()


def _constants() -> Iterator[str]:
    """Yield definitions of the shader's constants."""
    numbered = ("", VIEWS), ("TONE_", TONE_MAPS), ("MAP_", displays.COLOR_MAPS), ("", COMPARISONS), ("", OVERLAYS)
    for prefix, listed in (*numbered, ("", DIFFERENCES)):
        for number, name in enumerate(listed):
            yield f"#define {prefix}{name.split()[0].upper()} {number}"
    yield f"#define MAPS {len(displays.COLOR_MAPS)}"
    yield f"#define WHEEL_CENTER vec3({displays.WHEEL_CENTER})"
    yield f"const vec3 label_colors[] = vec3[]({', '.join(f'vec3{color}' for color in displays.LABEL_COLORS)});"
    colors = zip(("NEGATIVE", "CLIPPED"), CLIPPING.values(), strict=True)
    for name, color in (*colors, ("SKY", displays.SKY), ("MASK_OFF", displays.MASK_OFF)):
        yield f"#define {name} vec3{color}"


class Canvas:
    """Draws layers in a context of OpenGL ≥ 3.3; use it from that context's thread.

    `frame` says what the layers refer to: set it with every new set of layers. Textures that `draw` and `overview`
    return are drawn into again by the next call of the same name and `target`, if that would change anything.
    """

    def __init__(self, ctx: moderngl.Context):
        self.ctx = ctx
        self.largest: int = ctx.info["GL_MAX_TEXTURE_SIZE"]  # pixels: a picture's width or height
        self._frame = FrameInfo((1, 1))
        self._changes = 0  # of layers and frame
        self._drawn: dict[str, tuple] = {}  # by target: what was drawn last, and the changes up to then
        self._tiles: tuple[Tile, ...] = ()
        self._programs: dict[tuple[int, ...], _Program] = {}
        self._layers: dict[str, Texture] = {}
        self._targets: dict[str, moderngl.Framebuffer] = {}
        self._nothing = _Shown(Texture(ctx, np.zeros((1, 1, 1, 1), np.uint8)), (-1, 0, -1, 0, 0, 0), {})
        tables = np.stack([displays.color_table(name) for name in displays.COLOR_MAPS])
        self._color_maps = ctx.texture((256, len(displays.COLOR_MAPS)), 3, tables.tobytes(), alignment=1, dtype="f4")
        self._color_maps.repeat_x = self._color_maps.repeat_y = False

    # ---- layers ----------------------------------------------------------------------------------------

    @property
    def frame(self) -> FrameInfo:
        return self._frame

    @frame.setter
    def frame(self, frame: FrameInfo) -> None:
        self._frame = frame
        self._changes += 1

    def upload(self, name: str, array: np.ndarray, spec: LayerSpec, frame: FrameInfo | None = None) -> None:
        """Upload an image as `name`: (H, W), (H, W, C) or, with `spec.planes` > 1, (planes, H, W[, C]); C ≤ 4. `frame`:
        its reference frame, if it differs from the others'.

        float16, float32 and uint8 go as they are (fastest when C-contiguous), other types as float32. An image wider
        or higher than the GPU's largest texture goes with every n-th pixel. An empty one is ignored.
        """
        texels = texels_of(array, spec, self.largest)
        if texels is None:
            return
        layer = self._layers.get(name)
        if layer is None or layer.format != (texels.shape, texels.dtype):
            self.forget([name])
            layer = self._layers[name] = Texture(self.ctx, texels)
        layer.texels.write(texels, alignment=1)
        layer.spec, layer.mipmaps, layer.frame = spec, 0, frame
        self._changes += 1

    @property
    def layers(self) -> dict[str, LayerSpec]:
        """Return the uploaded layers."""
        return {name: layer.spec for name, layer in self._layers.items() if layer.spec is not None}

    @property
    def nbytes(self) -> int:
        """Bytes of all textures of layers, without mipmaps."""
        return sum(math.prod(layer.format[0]) * layer.format[1].itemsize for layer in self._layers.values())

    def forget(self, layers: Iterable[str]) -> None:
        """Release these layers, if they are there."""
        for name in layers:
            layer = self._layers.pop(name, None)
            if layer:
                layer.release()
                self._changes += 1

    def release(self) -> None:
        """Release everything; the canvas must not be used any more."""
        self.forget(list(self._layers))
        for framebuffer in self._targets.values():
            _release(framebuffer)
        for program in self._programs.values():
            program.release()
        self._nothing.texture.release()
        self._color_maps.release()
        self._targets, self._programs = {}, {}

    # ---- drawing ---------------------------------------------------------------------------------------

    def draw(self, view: View, size: Size, target: str = "canvas") -> moderngl.Texture:
        """Draw `view` at `size` (width, height); returns RGBA8, opaque, first row on top. `target` distinguishes
        pictures that exist at the same time."""
        framebuffer = self._target(target, size)
        if self._is_due(target, made := (replace(view), size, self._changes)):
            with self.ctx.scope(framebuffer, moderngl.NOTHING):
                framebuffer.clear(*view.background, 1.0)
                self._draw(view, (0, 0), framebuffer)
            self._drawn[target] = made
        return self._texture(framebuffer)

    def _is_due(self, target: str, made: tuple) -> bool:
        """Return whether drawing this into the target would change what is there, which is unknown from then on until
        `_drawn` has it."""
        if self._drawn.get(target) == made:
            return False
        self._drawn.pop(target, None)
        return True

    def overview(
        self,
        tiles: Sequence[tuple[str, Display]],
        size: Size,
        *,
        caption: int = 20,
        gap: int = 6,
        background: Rgb = (0.11, 0.11, 0.12),
    ) -> tuple[moderngl.Texture, tuple[Tile, ...]]:
        """Draw many layers as a grid as large as fits `size`, with `caption` pixels left free under each.

        Returns the picture, and where which layer is.
        """
        framebuffer = self._target("overview", size)
        if not self._is_due("overview", made := (tuple(tiles), size, caption, gap, background, self._changes)):
            return self._texture(framebuffer), self._tiles
        places = _grid(len(tiles), framebuffer.size, self.frame.display_size, caption, gap)
        self._tiles = tuple(Tile(name, *place) for (name, _), place in zip(tiles, places, strict=True))
        with self.ctx.scope(framebuffer, moderngl.NOTHING):
            framebuffer.clear(*background, 1.0)
            for tile, (name, display) in zip(self._tiles, tiles, strict=True):
                view = View(name, display, background=background, grid=False)
                view.fit((tile.width, tile.height), self.frame.display_size)
                framebuffer.viewport = (tile.x, tile.y, tile.width, tile.height)
                self._draw(view, (tile.x, tile.y), framebuffer)
            framebuffer.viewport = (0, 0, *framebuffer.size)
        self._drawn["overview"] = made
        return self._texture(framebuffer), self._tiles

    @staticmethod
    def _texture(framebuffer: moderngl.Framebuffer) -> moderngl.Texture:
        texture = framebuffer.color_attachments[0]
        assert isinstance(texture, moderngl.Texture)  # as `_target` makes it
        return texture

    def _target(self, name: str, size: Size) -> moderngl.Framebuffer:
        size = max(int(size[0]), 1), max(int(size[1]), 1)
        old = self._targets.get(name)
        if old is not None and old.size == size:
            return old
        if old is not None:
            _release(old)
        texture = self.ctx.texture(size, 4)
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)  # it is shown pixel by pixel
        self._targets[name] = self.ctx.framebuffer([texture])
        return self._targets[name]

    def draw_into(
        self, window: moderngl.Framebuffer, view: View, corner: Size, size: Size, alone: bool = False
    ) -> None:
        """Draw `view` at `size` into a window, whose first row is the bottom one: the lower left corner at `corner`.
        `alone`: the background stays as it is."""
        with self.ctx.scope(window, moderngl.NOTHING):
            if not alone:
                window.clear(*view.background, 1.0, viewport=(*corner, *size))
            whole, window.viewport = window.viewport, (*corner, *size)
            self._draw(view, corner, window, bottom_up=True)
            window.viewport = whole

    def _draw(
        self, view: View, corner: tuple[int, int], framebuffer: moderngl.Framebuffer, bottom_up: bool = False
    ) -> None:
        """Draw `view` into the framebuffer's viewport, which has its `corner` there and is full of background."""
        a, b = (view.a, view.a_display), (view.b, view.b_display)
        size = framebuffer.viewport[2:]

        def draw(layers: Sequence[tuple[str | None, Display | None]], part: tuple[int, int, int, int]) -> None:
            left, top, right, bottom = part
            if left >= right or top >= bottom:
                return
            program = self._prepare(view, layers, corner, size, bottom_up)
            first = size[1] - bottom if bottom_up else top
            framebuffer.scissor = corner[0] + left, corner[1] + first, right - left, bottom - top
            program.triangle.render(moderngl.TRIANGLES, vertices=3)
            whole: Any = None  # which the stub leaves out
            framebuffer.scissor = whole

        left, top, right, bottom = self._display_rectangle(view, size)
        if view.compare != "split":
            mixed = b if view.compare == "difference" else (None, None)
            draw((a, mixed), (left, top, right, bottom))
            return
        line, width = round(view.split * size[0]), max(round(view.line), 1)
        middle = min(max(line, left), right)
        draw((a, (None, None)), (left, top, middle, bottom))
        draw((b, (None, None)), (middle, top, right, bottom))
        first, last = max(line - width // 2, 0), min(line - width // 2 + width, size[0])
        if first < last:
            framebuffer.clear(1.0, 1.0, 1.0, 1.0, viewport=(corner[0] + first, corner[1], last - first, size[1]))

    def _prepare(
        self,
        view: View,
        layers: Sequence[tuple[str | None, Display | None]],
        corner: tuple[int, int],
        size: Size,
        bottom_up: bool,
    ) -> _Program:
        """Return the program that draws two layers where the second is mixed with the first, else one, with its
        uniforms."""
        shown = [self._shown(name, display, view.zoom) for name, display in layers]
        contrast = self._grid_contrast(view, shown[0])
        compare = COMPARISONS.index(view.compare) if view.compare == "difference" else 0
        program = self._program(
            *(n for layer in shown for n in layer.variant),
            compare,
            OVERLAYS.index(view.overlay),
            int(contrast > 0),
        )
        for index, layer in enumerate(shown):
            program.set(f"layer[{index}].", layer.uniforms)
        depth = self._layers.get(names.RENDERED_DEPTH)
        for unit, texture in enumerate((*(layer.texture for layer in shown), depth)):
            (texture or self._nothing.texture).texels.use(unit)
        self._color_maps.use(_UNITS["color_maps"])
        program.set("", {"has_depth": depth is not None} | self._frame_uniforms())
        display = self.frame.display_size
        values = {
            "background": view.background,
            "center": tuple(at / side for at, side in zip(view.center, display, strict=True)),
            "step": tuple(1 / (view.zoom * side) for side in display),
            "bottom_up": bottom_up,
            "corner": corner,
            "size": size,
            "grid_contrast": contrast,
            "difference": DIFFERENCES.index(view.difference),
            "difference_high": self._difference_high(view, layers),
        }
        program.set("", values)
        return program

    def _difference_high(self, view: View, layers: Sequence[tuple[str | None, Display | None]]) -> float:
        """Return the difference between two layers that has full color."""
        sides = []
        for name, display in layers:
            layer = self._layers.get(name) if name is not None else None
            if layer is not None and layer.spec is not None and display is not None:
                sides.append((layer.spec, display))
        if len(sides) < 2:
            return 1.0
        return full_scale(compared_as(*sides), view.difference, view.gain, sides[0][1])

    def _grid_contrast(self, view: View, shown: _Shown) -> float:
        """Return the contrast of the lines between pixels; 0: there are none."""
        narrow = min(view.zoom, *shown.uniforms.get("texel", (0.0,)))
        if not view.grid or narrow < _GRID[0]:
            return 0.0
        share = min((narrow - _GRID[0]) / (_GRID[1] - _GRID[0]), 1.0)
        return 0.08 + 0.25 * share * share * (3.0 - 2.0 * share)

    def _display_rectangle(self, view: View, size: Size) -> tuple[int, int, int, int]:
        """Return left, top, right and bottom, in a picture of `size`, of all pixels whose centers show the display: the
        shader does not look for its borders."""
        low, high = view.screen_at(size, 0, 0), view.screen_at(size, *self.frame.display_size)
        left, top = (min(max(math.ceil(low[i] - 0.5), 0), size[i]) for i in (0, 1))
        right, bottom = (min(max(math.ceil(high[i] - 0.5), 0), size[i]) for i in (0, 1))
        return left, top, right, bottom

    def _program(self, *key: int) -> _Program:
        """Return the shader for the choice `key` of _VARIANT, compiled at its first use."""
        if key not in self._programs:
            self._programs[key] = _Program(self.ctx, key)
        return self._programs[key]

    def _frame_uniforms(self) -> dict[str, Any]:
        frame = self.frame
        values: dict[str, Any] = {"has_source": frame.source is not None}
        if frame.source is not None:
            fx, fy, *center = frame.source.intrinsics
            values["source_inverse"] = 1 / fx, 1 / fy, *center
        return values

    def _shown(self, name: str | None, display: Display | None, zoom: float) -> _Shown:
        """Return layer a or b as the shader takes it at this zoom; the background if it is not uploaded."""
        layer = self._layers.get(name) if name is not None else None
        if layer is None or layer.spec is None or display is None:
            return self._nothing
        spec, frame = layer.spec, layer.frame or self.frame
        view, channel = shown_as(spec, display)
        area = frame.area(spec)
        texel = [zoom * frame.display_size[i] / (layer.size[i] * abs(area[i + 2] - area[i])) for i in (0, 1)]
        smooth = view == "color" and min(texel) < 1.0
        level = min(-math.log2(max(min(texel), 1e-9)), int(math.log2(max(layer.size)))) if smooth else 0.0
        layer.have_mipmaps(math.ceil(level))
        low, high = display.low, display.high
        uniforms = {
            "components": layer.components,
            "plane": min(max(display.plane, 0), layer.planes - 1),
            "unit": layer.unit,
            "area": area,
            "own": frame.own_place(spec),
            "texel": texel,
            "level": level,
            "gain": 2.0**display.exposure * frame.exposure,
            "color_map": displays.COLOR_MAPS.index(display.color_map),
            "range": (low, high if high != low else low + abs(low) * 1e-6 + 1e-12),
            "inverse": display.inverse,
            "motion_scale": max(display.motion_scale, 1e-6) * (-1 if display.reverse else 1),
            "tint": display.tint,
            "label_flip": displays.label_flip(spec),
        }
        tone_map = TONE_MAPS.index(display.tone_map) if view == "color" else 0
        weighted = spec.view == "color" and spec.components[3:] == ("weight",)
        variant = VIEWS.index(view), int(smooth), min(channel, layer.components - 1), tone_map
        return _Shown(layer, (*variant, int(weighted), int(area == (0.0, 0.0, 1.0, 1.0))), uniforms)


def read(texture: moderngl.Texture) -> np.ndarray:
    """Return (H, W, 4) uint8 of a texture that `Canvas` has drawn, top row first."""
    width, height = texture.size
    return np.frombuffer(texture.read(alignment=1), np.uint8).reshape(height, width, 4)


def _release(framebuffer: moderngl.Framebuffer) -> None:
    for texture in framebuffer.color_attachments:
        texture.release()
    framebuffer.release()


def _grid(count: int, size: Size, picture: Size, caption: int, gap: int) -> list[tuple[int, int, int, int]]:
    """Return (x, y, width, height) of `count` pictures of the aspect of `picture`, as large as fits `size`."""
    best, best_columns = (0, 0), 1
    for columns in range(1, count + 1):
        rows = math.ceil(count / columns)
        width = (size[0] - gap * (columns + 1)) / columns
        height = (size[1] - gap * (rows + 1)) / rows - caption
        scale = min(width / picture[0], height / picture[1])
        fitting = tuple(max(int(n * scale), 1) for n in picture)
        if fitting[0] > best[0]:
            best, best_columns = fitting, columns
    width, height = max(best[0], 1), max(best[1], 1)
    left = max((size[0] - best_columns * (width + gap) + gap) // 2, 0)
    steps = ((index % best_columns, index // best_columns) for index in range(count))
    return [(left + i * (width + gap), gap + j * (height + caption + gap), width, height) for i, j in steps]
