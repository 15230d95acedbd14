"""Drives the viewer with the test engine of Dear ImGui: what the GUI cases need to click, type, look and wait."""

from __future__ import annotations

import json
import time
import traceback
from pathlib import Path

import numpy as np
from imgui_bundle import glfw_utils, hello_imgui, imgui, implot  # noqa: F401  before glfw

import glfw  # isort: skip
from PIL import Image

from gffe_cl import Options
from gffe_cl.viewer.picture.canvas import read
from gffe_cl.viewer.picture.displays import Display
from gffe_cl.viewer.state.parameters import ALWAYS
from gffe_cl.viewer.window import running
from gffe_cl.viewer.window.app import App

KEY = imgui.Key
CTRL, SHIFT = KEY.mod_ctrl.value, KEY.mod_shift.value
PATIENCE = 120.0  # seconds


def collector():
    """(cases by name, a decorator that adds one)."""
    cases: dict = {}

    def add(function):
        cases[function.__name__] = function
        return function

    return cases, add


class Gui:
    """The running viewer, for a case: `ctx` is the test engine's context.

    Cases run on a thread while the interface stands still; GL belongs to the interface's thread (`on_screen`).
    """

    def __init__(self, app: App, sequences: Path, artifacts: Path):
        self.app, self.model, self.sequences, self.artifacts = app, app.model, sequences, artifacts
        self.ctx = None
        self._jobs: list = []
        hello_imgui.get_runner_params().callbacks.before_swap = self._do_jobs

    def run(self, ctx, name: str, case) -> dict:
        """Outcome of one case: the traceback if it failed; a picture of its end is kept."""
        self.ctx, start, error = ctx, time.perf_counter(), None
        try:
            opened = lambda: self.model.source is not None and self.model.contents.result is not None  # noqa: E731
            self.wait(opened, "the sequence", 4 * PATIENCE)  # kernels are built first
            if name not in ("restart", "leave"):
                self.reset()
            case(self)
            if not (self.artifacts / f"{name}.png").exists():
                self.shot(name)
        except BaseException:  # the test engine would go on without a word
            error = traceback.format_exc()
            print(f"--- {name}\n{error}", flush=True)
        return {"error": error, "seconds": round(time.perf_counter() - start, 2)}

    # ---- waiting -----------------------------------------------------------------------------------------

    def frames(self, count: int = 1) -> None:
        self.ctx.yield_(count)

    def wait(self, until, what: str = "", patience: float = PATIENCE) -> None:
        end = time.perf_counter() + patience
        while not until():
            assert time.perf_counter() < end, f"waited {patience:g} s in vain for {what or until}"
            self.ctx.yield_()

    def settle(self) -> None:
        """Until what was asked for is on the screen."""
        self.ctx.yield_()
        self.wait(lambda: self.model.settled and self.model.saving.work is None, "a settled picture")
        self.ctx.yield_()

    def on_screen(self, job):
        """Result of `job()` on the interface's thread, when the frame is drawn and not yet shown."""
        made: list = []
        self._jobs.append((job, made))
        self.wait(lambda: made, "a frame")
        if isinstance(made[0], Exception):
            raise made[0]
        return made[0]

    def _do_jobs(self) -> None:
        while self._jobs:
            job, made = self._jobs.pop(0)
            try:
                made.append(job())
            except Exception as error:
                made.append(error)

    # ---- looking -----------------------------------------------------------------------------------------

    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8: the canvas as it is on the screen."""
        return self.on_screen(
            lambda: read(self.app.canvas.draw(self.app.model.comparison.shown(), self.app.canvas_size))[..., :3].astype(
                np.int16
            )
        )

    def window(self) -> np.ndarray:
        """(H, W, 3) uint8: the whole window."""

        def grab():
            width, height = glfw.get_framebuffer_size(glfw_utils.glfw_window_hello_imgui())
            framebuffer = self.app.canvas.ctx.detect_framebuffer(0)
            pixels = np.frombuffer(framebuffer.read((width, height), components=3, alignment=1), np.uint8)
            return pixels.reshape(height, width, 3)[::-1].copy()

        return self.on_screen(grab)

    def shot(self, name: str) -> None:
        """Keep a picture of the window."""
        Image.fromarray(self.window()).save(self.artifacts / f"{name}.png")

    def images(self) -> dict[str, np.ndarray]:
        """All layers of the present slot."""
        before = self.model.choices.overview
        self.model.choices.overview = True
        self.settle()
        self.wait(lambda: len(self.model.contents.result.images) > 5, "all layers")
        found = dict(self.model.contents.result.images)
        self.model.choices.overview = before
        self.settle()
        return found

    def area(self, ref: str = "//Picture/###picture"):
        """(left, top, width, height) of an item on the screen."""
        box = self.ctx.item_info(ref).rect_full
        return box.min.x, box.min.y, box.max.x - box.min.x, box.max.y - box.min.y

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Where on the screen display position (x, y) is."""
        left, top, width, height = self.area()
        sx, sy = self.model.view.screen_at((int(width), int(height)), x, y)
        return left + sx, top + sy

    def exists(self, ref: str) -> bool:
        return self.ctx.item_info(ref, imgui.test_engine.TestOpFlags_.no_error.value).id_ != 0

    def told(self) -> str:
        return "\n".join(message.text for message in self.model.messages)

    # ---- acting ------------------------------------------------------------------------------------------

    def key(self, key, modifiers: int = 0, count: int = 1) -> None:
        self.ctx.key_press(modifiers | key.value, count)
        self._done(f"key {key}")

    def click(self, ref: str) -> None:
        self.ctx.item_click(ref)
        self._done(ref)

    def point(self, x: float, y: float) -> None:
        """Move the mouse to a position on the screen."""
        self.ctx.mouse_move_to_pos((x, y))
        self.frames()

    def drag(self, start, end) -> None:
        self.point(*start)
        self.ctx.mouse_down(0)
        self.frames(2)
        self.point(*((a + b) / 2 for a, b in zip(start, end, strict=True)))
        self.point(*end)
        self.ctx.mouse_up(0)
        self.frames(2)

    def choose(self, combo: str, text: str) -> None:
        """Open a combo box and choose one of its texts."""
        self.click(combo)
        self.click(f"//$FOCUSED/{text}")
        self.frames()

    def _done(self, what: str) -> None:
        assert not self.ctx.is_error(), f"the test engine could not do this: {what}"
        self.frames()

    def open(self, target) -> None:
        self.model.open(str(target))
        self.wait(lambda: self.model.document.notice == "", f"{target} to open")
        self.frames(3)
        self.settle()

    def reset(self, slot: int = 13) -> None:
        """The state in which every case starts."""
        model, view = self.model, self.model.view
        model.playback.pause()
        model.playback.clear_points()
        model.playback.mode, model.playback.speed, model.playback.loop = "real time", 1.0, True
        model.parameters.options = Options(**ALWAYS)
        model.set("n", 1)
        model.choices.overview = False
        model.choices.measuring = False
        model.messages = []
        model.settings.displays.clear()
        model.looks.forget()
        model.pointing.pick(None)
        model.walk.forget()
        view.a, view.b, view.compare, view.overlay, view.split = "final", None, "off", "none", 0.5
        view.a_display = Display()
        model.playback.seek(slot)
        model.framing.due = True
        self.ctx.popup_close_all()
        self.ctx.mouse_move_to_pos((5, 5))
        self.settle()


def run(app: App, cases: dict, report: Path, artifacts: Path, at_end=None, size=None) -> None:
    """Run all `cases` (name → function of a Gui) in the window of `app`, then `at_end`; write the
    JSON `report` and close."""
    outcomes: dict[str, dict] = {}

    def register(app: App) -> None:
        engine = hello_imgui.get_imgui_test_engine()
        io = imgui.test_engine.get_io(engine)
        io.config_run_speed = imgui.test_engine.TestRunSpeed.fast
        io.config_no_throttle = True
        io.config_watchdog_kill_test = 4 * PATIENCE
        gui = Gui(app, report.parent, artifacts)
        steps = {
            name: lambda ctx, name=name: outcomes.update({name: gui.run(ctx, name, cases[name])}) for name in cases
        }
        for name, step in {**steps, "leave": lambda ctx: leave(gui, ctx)}.items():
            test = imgui.test_engine.register_test(engine, "viewer", name)
            test.test_func = step
            imgui.test_engine.queue_test(engine, test)

    def leave(gui: Gui, ctx) -> None:
        outcomes["leave"] = gui.run(ctx, "leave", at_end or (lambda gui: None))
        report.write_text(json.dumps({"cases": outcomes, "closed": time.time()}, indent=1))
        app.close()

    running.run(app, size, test=register)
