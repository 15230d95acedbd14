"""GUI cases: comparing and measuring."""

from __future__ import annotations

import numpy as np
from viewer_gui_driver import KEY, Gui, collector

CASES, case = collector()


@case
def split(gui: Gui):
    """The wipe's line is dragged; left of it is A, right of it B."""
    model, values = gui.model, gui.values
    gui.key(KEY.w)
    model.view.b = "frame.depth"
    gui.settle()
    left, top, width, height = gui.area()
    middle = top + height / 2
    gui.drag((left + width / 2, middle), (left + 0.3 * width, middle))
    values["split"] = model.view.split
    gui.settle()
    gui.shot("split")
    picture, split = gui.picture(), int(model.view.split * width)
    model.view.compare = "off"
    gui.settle()
    a = gui.picture()
    model.show_layer("frame.depth")
    gui.settle()
    b = gui.picture()
    values["left is A"] = bool((picture[:, : split - 2] == a[:, : split - 2]).all())
    values["right is B"] = bool((picture[:, split + 2 :] == b[:, split + 2 :]).all())
    values["A is B"] = bool((a == b).all())
    values["center moved"] = bool(model.view.center != (model.source.width / 2, model.source.height / 2))


@case
def difference_and_error(gui: Gui):
    model, values = gui.model, gui.values
    gui.ctx.window_focus("//Compare")
    gui.frames(2)
    gui.click("//Compare/###compare difference")
    gui.settle()
    values["b"] = model.view.b
    difference = gui.picture()
    gui.shot("difference")
    gui.key(KEY.m)
    gui.settle()
    error = gui.picture()
    gui.shot("error map")
    values["compare"] = model.view.compare
    gui.key(KEY.m)
    gui.settle()
    a = gui.picture()
    gui.key(KEY.t)
    gui.settle()
    values["shown after T"] = model.view.a
    b = gui.picture()
    gui.key(KEY.t)
    expected = np.clip(np.abs(a - b) * 4, 0, 255)
    inside = (a != a[0, 0]).any(-1) & (b != b[0, 0]).any(-1)
    values["largest fault of the difference"] = int(np.abs(difference - expected)[inside].max())
    values["difference is seen"] = float((difference[inside] > 20).mean())
    mean = np.abs(a - b).mean(-1)
    heat = error.sum(-1)
    values["error follows the difference"] = float(np.corrcoef(np.minimum(mean[inside], 25), heat[inside])[0, 1])
    gui.ctx.window_focus("//Modules")


@case
def flip(gui: Gui):
    """B is seen as long as its key is held."""
    model, values = gui.model, gui.values
    model.view.b = "rendered.depth"
    gui.key(KEY.f)
    gui.settle()
    a = gui.picture()
    model.comparison.set("flip")
    gui.settle()
    gui.ctx.key_down(KEY.b.value)
    gui.frames(3)
    gui.settle()
    held = gui.picture()
    gui.ctx.key_up(KEY.b.value)
    gui.frames(2)
    released = gui.picture()
    model.show_layer("rendered.depth")
    gui.settle()
    values["held shows B"] = bool((held == gui.picture()).all())
    values["A differs"] = bool((a != held).any())
    values["released shows A"] = bool((released == a).all())


@case
def flip_error(gui: Gui):
    """NVIDIA's FLIP where it is installed, else the reason why not."""
    model, values = gui.model, gui.values
    values["reason"] = model.comparison.why_not("flip error")
    gui.ctx.window_focus("//Compare")
    gui.frames(2)
    if values["reason"] is None:
        model.comparison.flip_high = 1.0
        gui.click("//Compare/###compare flip error")
        gui.settle()
        gui.shot("FLIP error")
        picture = gui.picture()
        values["drawn"] = int(picture.max())
        from flip_evaluator import evaluate

        from gffe_cl.lab.metrics import to_display

        images = [model.contents.result.images[name][..., :3] for name in ("truth", "final")]
        true, shown = (to_display(image, model.source.exposure) for image in images)
        wanted = evaluate(true, shown, "LDR", applyMagma=False)[0][..., 0]
        xs, ys = (10, 100, 150, 170), (20, 50, 90, 100)
        values["faults"] = []
        for x, y in zip(xs, ys, strict=True):
            sx, sy = model.view.screen_at((picture.shape[1], picture.shape[0]), x + 0.5, y + 0.5)
            heat = np.clip(3 * wanted[y, x] - np.arange(3), 0, 1) * 255
            values["faults"].append(float(np.abs(picture[int(sy), int(sx)] - heat).max()))
        model.set("n", 3)
        gui.settle()
        gui.key(KEY.right_arrow)  # to a time without ground truth
        gui.settle()
        values["colors without truth"] = len(np.unique(gui.inside().reshape(-1, 3), axis=0))
    gui.ctx.window_focus("//Modules")


@case
def measuring(gui: Gui):
    from gffe_cl.lab.metrics import psnr, ssim, to_display

    model, values = gui.model, gui.values
    gui.ctx.window_focus("//Compare")
    gui.frames(2)
    gui.click("//Compare/measure")
    gui.wait(lambda: model.metrics.get(13) and "ssim" in model.metrics[13].values, "the metrics")
    model.view.b = "truth"
    model.comparison.set("flip")
    gui.settle()
    shown, true = (
        to_display(model.contents.result.images[name][..., :3], model.source.exposure) for name in ("final", "truth")
    )
    score = model.metrics[13].values
    values |= {"psnr": score["psnr"], "ssim": score["ssim"], "by hand": (psnr(shown, true), ssim(shown, true))}
    for slot in (3, 5, 7, 9, 11):
        model.playback.seek(slot)
        gui.settle()
    gui.wait(lambda: len(model.metrics) >= 6, "metrics of all slots")
    values["slots"] = sorted(model.metrics)
    gui.shot("measuring")
    gui.click("//Compare/measure")
    gui.ctx.window_focus("//Modules")
