"""Frames of playback that redraw the picture alone: the rest of the window stays as the interface was last drawn."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from imgui_bundle import imgui

from ..picture.canvas import Rectangle
from .interface import Interface

_INTERFACE = 1 / 12  # seconds between frames of the whole interface
_AFTER_INPUT = 0.3  # seconds in which the whole interface follows keys and mouse


class PictureFrames:
    """Drawing of the picture alone, between two frames of the interface.

    It is used only where a CPU draws the window (Mesa's llvmpipe). There the interface costs more than the picture, and
    a swap of buffers keeps the window's contents, which other drivers do not promise. After input from keyboard or
    mouse every frame draws the whole interface.
    """

    def __init__(self, app: Interface):
        self._app = app
        self.on_picture: Callable[[Any], None] | None = None  # given the interface, once per picture drawn here
        self._allowed = False
        self._drawn_at = self._input_at = 0.0

    def look_for_input(self) -> None:
        """Note input from keyboard and mouse. Call within a frame of the interface."""
        io = imgui.get_io()
        moved = io.mouse_delta.x or io.mouse_delta.y or io.mouse_wheel or io.mouse_wheel_h
        if moved or imgui.is_any_mouse_down() or imgui.is_any_item_active() or io.key_mods or io.want_text_input:
            self._input_at = self._app.clock()

    def allow(self, covered: bool) -> None:
        """Decide whether frames of the picture alone may follow. Call when a frame of the interface is drawn.
        `covered`: whether a window lies over the panels."""
        app, io = self._app, imgui.get_io()
        self._drawn_at = now = app.clock()
        scaled = io.display_framebuffer_scale.x != 1.0 or io.display_framebuffer_scale.y != 1.0
        self._allowed = (
            app.spot is not None
            and "llvmpipe" in app.canvas.ctx.info["GL_RENDERER"]
            and app.model.playback.playing
            and not (scaled or covered)
            and (app.spot.hovered or not imgui.is_any_item_hovered())  # tooltips may reach over the picture
            and now - self._input_at > _AFTER_INPUT
        )

    def show(self) -> None:
        """Continue playback until the interface is due or playback stops."""
        app = self._app
        while self._allowed:
            rest = app.model.playback.rest(app.clock())
            if app.clock() + rest > self._drawn_at + _INTERFACE:
                return
            time.sleep(rest)
            before = app.model.contents.changes
            app.model.update(app.clock(), app.canvas)
            if not app.model.playback.playing:
                return
            if app.model.contents.changes == before:
                time.sleep(0.001)
                continue
            self._draw()

    def _draw(self) -> None:
        import glfw
        from imgui_bundle import glfw_utils

        spot, canvas = self._app.spot, self._app.canvas
        assert spot is not None
        canvas.draw_into(
            canvas.ctx.detect_framebuffer(0), spot.view, spot.origin, spot.size, uncovered(spot.size, spot.covers)
        )
        window: Any = glfw_utils.glfw_window_hello_imgui()
        glfw.swap_buffers(window)
        if self.on_picture is not None:
            self.on_picture(self._app)


def uncovered(size: tuple[int, int], covers: list[Rectangle]) -> Iterator[Rectangle]:
    """Yield rectangles that together are the image of `size` without `covers`."""
    width, height = size
    edges = sorted({0, height, *(min(max(y, 0), height) for cover in covers for y in cover[1::2])})
    for top, bottom in zip(edges, edges[1:], strict=False):
        left = 0
        for cover in sorted(covers):
            if cover[1] < bottom and top < cover[3] and cover[2] > left:
                if cover[0] > left:
                    yield left, top, min(cover[0], width), bottom
                left = cover[2]
        if left < width:
            yield left, top, width, bottom
