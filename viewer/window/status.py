"""Status bar, messages over the picture, and progress of saving."""

from __future__ import annotations

import math

from imgui_bundle import ImVec4, hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from gffe_cl.engine.opencl.program import first_error
from ..picture.shown_numbers import sides_of, values_in
from ..state.captions import Message, value_text
from ..state.comparing import BUILD_LETTERS
from ..state.model import Model
from . import widgets
from .app import App

_BLUE = ImVec4(0.36, 0.62, 0.95, 1.0)
_SECONDS = {"error": 30.0, "note": 8.0}  # that a message stands there, by its kind
_OVER_PICTURE = {"error": 6.0, "title": 8.0}  # ... over the picture
_ABOVE_FOOT = 2.2  # em: messages are above the captions at the bottom of the picture
_GAP = "     "
_KERNEL_SHARE = 0.7  # of the bar, at most, if there is another message


def lately(app: App) -> list[Message]:
    """Return the messages that stand in the bar."""
    return [message for message in app.model.lately(app.clock(), _SECONDS) if message.kind != "title"]


def draw(app: App) -> None:
    model, told = app.model, False
    shown = lately(app)
    if model.engine.build_error:
        _kernel_error(model.engine.build_log, 1.0 if not shown else _KERNEL_SHARE)
        told = True
    if shown:
        last = shown[-1]
        _beside(told)
        imgui.text_colored(widgets.red() if last.error else _BLUE, _icon(last.error))
        imgui.same_line()
        text, saved = widgets.cut(last.text.replace("\n", " "), imgui.get_content_region_avail().x), model.saving.saved
        if saved is not None and str(saved) in last.text:  # a click opens its folder
            imgui.text_link_open_url(f"{text}###saved", str(saved.parent))
        else:
            imgui.text(text)
        widgets.tooltip("\n".join(message.text for message in shown))
        told = True
    _beside(told)
    listed, room = parts(model), imgui.get_content_region_avail().x
    whole = _GAP.join(listed)
    while len(listed) > 1 and imgui.calc_text_size(_GAP.join(listed)).x > room:
        listed.pop()  # what matters least is last
    text = widgets.cut(_GAP.join(listed), room)
    if told:
        imgui.text_disabled(text)
    else:
        imgui.text(text)
    widgets.tooltip(whole if text != whole else "")


def _kernel_error(log: str, share: float) -> None:
    """Draw the compiler's first error with file and line; a click copies the whole log."""
    imgui.text_colored(widgets.red(), f"{_icon(True)} kernels do not build:")
    imgui.same_line()
    imgui.push_style_color(imgui.Col_.text_link, widgets.red())
    text = widgets.cut(first_error(log), share * imgui.get_content_region_avail().x)
    if imgui.text_link(f"{text}###kernel_error"):
        imgui.set_clipboard_text(log)
    imgui.pop_style_color()
    widgets.tooltip(f"{log}\n\nThe last good kernels are running. Click: copy this.")


def _icon(error: bool) -> str:
    return icons.ICON_FA_TRIANGLE_EXCLAMATION if error else icons.ICON_FA_CIRCLE_INFO


def _beside(something: bool) -> None:
    if something:
        imgui.same_line(0, hello_imgui.em_size(2))


def parts(model: Model) -> list[str]:
    """Return the texts of the status bar: the values under the pointer, warnings, the device, the open sequence, and
    its time."""
    told = [model.engine.device_name or "opening the device …"]
    if model.source is not None:
        info = model.source
        told.append(f"{info.name}   {info.width}×{info.height}")
        if info.render_size != (info.width, info.height):
            told.append(f"rendered {info.render_size[0]}×{info.render_size[1]}")
    if model.contents.result is not None:
        kept = "from the cache, " if model.showing.from_cache else ""
        told.append(f"{kept}computed in {model.contents.result.wall_ms:.0f} ms{_build(model)}")
    return [*_under_pointer(model), *model.document.warnings, *told]


def _build(model: Model) -> str:
    """Return which of several builds of the kernels made the picture; empty while there was one only."""
    recipe = model.contents.result.key.recipe if model.contents.result is not None else None
    return f" with kernels {recipe.kernels[:BUILD_LETTERS]}" if recipe is not None and model.engine.builds > 1 else ""


def _under_pointer(model: Model) -> list[str]:
    """Return the value of the displayed layer under the pointer in words, where layers are compared A, B and A − B; an
    empty list without one."""
    pixel, inspection, spec = model.pointing.pixel, model.pointing.inspection, model.contents.spec(model.view.a)
    view = model.comparison.shown()
    if view.compare != "off" and pixel is not None and model.current:
        sides = sides_of(view, model.contents)
        specs = {letter: side.spec for letter, side in sides}
        values = values_in(sides, (*pixel, pixel[0] + 1, pixel[1] + 1)).items()
        texts = [
            f"{name}  {value_text(specs[name], of[0]) if name in specs else '  '.join(map(_apart, of[0]))}"
            for name, of in values
        ]
        return [f"({pixel[0]}, {pixel[1]})", *texts]
    if inspection is None or not model.pointing.shows_values or spec is None or spec.name not in inspection.values:
        return []
    x, y = inspection.pixel
    told = f"({x}, {y})   {value_text(spec, inspection.values[spec.name])}"
    if inspection.source is not None and spec.name in inspection.origin:
        right, down = inspection.source
        told += f"   from ({right:.1f}, {down:.1f})   {value_text(spec, inspection.origin[spec.name])}"
    return [told]


def _apart(by: float) -> str:
    return f"{by:+.4g}" if math.isfinite(by) else "–"


def messages(app: App) -> None:
    """Draw recent errors and a script's title at the foot of the picture; a click dismisses them, as Escape does
    where no window is open."""
    lately = app.model.lately(app.clock(), _OVER_PICTURE)
    shown = [message for message in lately if message.kind != "note" and not message.dismissed]
    if not shown:
        return
    app.is_bare = False
    x, y = app.foot or imgui.get_main_viewport().get_center()
    imgui.set_next_window_pos((x, y - hello_imgui.em_size(_ABOVE_FOOT)), imgui.Cond_.always.value, (0.5, 1.0))
    flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_docking
    flags |= imgui.WindowFlags_.no_focus_on_appearing | imgui.WindowFlags_.no_nav
    widgets.floating()
    imgui.begin("###messages", None, int(flags))
    imgui.push_text_wrap_pos(hello_imgui.em_size(36))
    for message in shown[-4:]:
        if message.error:
            imgui.text_colored(widgets.red(), "error")
            imgui.same_line()
        imgui.text_unformatted(message.text)
    imgui.pop_text_wrap_pos()
    if imgui.is_window_hovered() and imgui.is_mouse_clicked(imgui.MouseButton_.left):
        app.model.dismiss_messages()
    imgui.end()


def progress(app: App) -> None:
    """Draw the progress of the export that is under way, with a button to stop it."""
    work = app.model.saving.work
    if work is None:
        return
    center = imgui.get_main_viewport().get_center()
    imgui.set_next_window_pos(center, imgui.Cond_.appearing.value, (0.5, 0.5))
    flags = imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_collapse | imgui.WindowFlags_.no_docking
    widgets.floating()
    imgui.begin("Saving###export", None, int(flags))
    imgui.text(f"→ {work.path.name}")
    imgui.progress_bar(work.done / max(work.total, 1), (hello_imgui.em_size(22), 0), f"{work.done} of {work.total}")
    if imgui.button("cancel###cancel_export"):
        work.cancelled = True
    imgui.end()
