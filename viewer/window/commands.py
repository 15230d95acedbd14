"""Table of actions, for menus, help, the command palette and scripts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from imgui_bundle import imgui

from gffe_cl.captures.scenes import SCENES, SITUATIONS
from gffe_cl.engine.core.errors import GffeError, printable
from gffe_cl.engine.options import Option
from ..engine.figures import QUANTITIES
from ..state.actions import Action, Actions, found_layer, frame_of, numbers, seconds_of, slot_of
from ..state.captions import Message
from ..state.comparing import FORMULAS, NEIGHBORS, WAYS
from ..state.model import Model
from ..state.parameters import ALL, parsed
from ..state.presets import command_line
from ..state.saving import LayersWork, PictureWork, require_file
from .app import App
from .docks import PANELS

_EXPOSURE_STEP = 0.5
LAYERS, _SCRIPT = "Layer", "Script"  # groups of actions that are in no menu
_LAST = ("Tools", "Panels", "Help")  # menus after those of modules and parameters

# ---- why an action cannot run --------------------------------------------------------------------------------


def opened(app: App) -> str | None:
    return None if app.model.source is not None else "nothing is open"


def needs(holds: Callable[[Model], object], reason: str) -> Callable[[App], str | None]:
    """Return what gives the `reason` why an action cannot run where something is open, but this does not hold."""
    return lambda app: opened(app) or (None if holds(app.model) else reason)


recorded = needs(lambda model: not model.source.live, "only of recorded frames")
on_disk = needs(lambda model: model.source.target, "only of a sequence on disk or a scene")
savable = needs(lambda model: model.saving.work is None, "something is being saved")
computing = needs(lambda model: model.stopped or model.showing.is_waiting, "nothing is being computed")
shows_error = needs(
    lambda model: model.view.compare in ("difference", "flip error"),
    "show a difference or an error first (D, M)",
)
has_left = needs(lambda model: model.walk.can_go_back, "no link was followed")


def second(app: App) -> str | None:
    """Return why there are no settings of B to go on with."""
    kept = app.model.kept.b
    if kept is None:
        return opened(app) or "no settings are kept as B"
    return opened(app) or ("B is pictures, not settings" if kept.place else None)


def has_truth(app: App) -> str | None:
    return opened(app) or app.model.contents.why_not("truth")


def findable(difference: bool, app: App) -> str | None:
    return opened(app) or app.model.survey.why_not(difference)


# ---- what needs more than a call ---------------------------------------------------------------------------------


def _toggle(of: object, name: str) -> None:
    setattr(of, name, not getattr(of, name))


def _look(app: App, change: str, *values: float) -> None:
    """Change the display of the layer A by a method of `Looks`."""
    getattr(app.model.looks, change)(app.model.view.a, *values)


def _copy_command(app: App, of_b: bool = False) -> None:
    model, kept = app.model, app.model.kept.b if of_b else None
    setup = model.setup if kept is None else kept.setup(model.n)
    app.copy(printable(command_line(setup, model.source, model.document.plan.seed)))


def _take_b(app: App) -> None:
    app.open_dialog("Compare with a sequence, an output of gffe run, or kernels", app.model.sides.take_b_from)


def _theme(app: App) -> None:
    app.model.settings.theme = "dark" if app.model.settings.theme == "light" else "light"


ACTIONS = (
    Action("open", "Open …", "File", "Ctrl+O", lambda app: app.open_dialog()),
    Action("open_path", "Open by path …", "File", "Ctrl+Shift+O", lambda app: app.open_path.open(app.model.open)),
    Action("reload", "Reload frames", "File", "Ctrl+R", lambda app: app.model.reload(), on_disk),
    Action("save_png", "Save picture as PNG", "File", "Ctrl+S",
           lambda app: app.model.saving.start(PictureWork), savable),
    Action("save_exr", "Save layers as EXR", "File", "Ctrl+E",
           lambda app: app.model.saving.start(LayersWork), savable),
    Action("save_into", "Save into …", "File", "",
           lambda app: app.open_dialog("Save into a folder", app.model.saving.choose_folder),
           tooltip="Choose the folder of what is saved from now on"),
    Action("quit", "Quit", "File", "Ctrl+Q", lambda app: app.close(), anywhere=True),
    Action("play", "Play / stop", "Playback", "Space", lambda app: app.model.playback.toggle(), opened),
    Action("step", "Next frame", "Playback", "Right", lambda app: app.model.playback.step(1), opened, repeat=True),
    Action("step_back", "Previous frame", "Playback", "Left", lambda app: app.model.playback.step(-1), opened,
           repeat=True),
    Action("next_rendered", "Next rendered frame", "Playback", "Shift+Right",
           lambda app: app.model.playback.step_rendered(1), opened, repeat=True),
    Action("previous_rendered", "Previous rendered frame", "Playback", "Shift+Left",
           lambda app: app.model.playback.step_rendered(-1), opened, repeat=True),
    Action("first", "First frame", "Playback", "Home", lambda app: app.model.playback.home(), opened),
    Action("last", "Last frame", "Playback", "End", lambda app: app.model.playback.end(), opened),
    Action("stop", "Stop computing", "Playback", "Ctrl+.", lambda app: app.model.stop_computing(), computing,
           tooltip="Cancel the current picture. Press again to resume"),
    Action("set_in", "Set in point", "Playback", "[", lambda app: app.model.playback.set_in(), opened),
    Action("set_out", "Set out point", "Playback", "]", lambda app: app.model.playback.set_out(), opened),
    Action("clear_points", "Clear in and out points", "Playback", "\\",
           lambda app: app.model.playback.clear_points(), opened),
    Action("fit", "Fit", "View", "F", lambda app: setattr(app.model.framing, "due", True), opened),
    Action("one_to_one", "1 : 1", "View", "Ctrl+0", lambda app: setattr(app.model.view, "zoom", 1.0), opened),
    Action("zoom_in", "Zoom in", "View", "+",
           lambda app: app.model.framing.zoom_in(app.canvas_size, app.model.pointing.picked), opened, also=("=",),
           tooltip="Zoom in at the picked pixel if it is seen, else at the middle"),
    Action("zoom_out", "Zoom out", "View", "-", lambda app: app.model.framing.zoom(0.5), opened),
    Action("next_layer", "Next layer", "View", "Down", lambda app: app.model.walk.next_layer(1), opened, repeat=True),
    Action("previous_layer", "Previous layer", "View", "Up", lambda app: app.model.walk.next_layer(-1), opened,
           repeat=True),
    Action("next_channel", "Next channel", "View", "C", lambda app: _look(app, "next_channel"), opened),
    Action("overview", "Overview of all layers", "View", "O",
           lambda app: _toggle(app.model.choices, "overview"), opened, lambda app: app.model.choices.overview),
    Action("brighter", "Brighter", "View", "E", lambda app: _look(app, "expose", _EXPOSURE_STEP), opened),
    Action("darker", "Darker", "View", "Shift+E", lambda app: _look(app, "expose", -_EXPOSURE_STEP), opened),
    Action("normalize", "Fit range to the picture", "View", "N", lambda app: _look(app, "fit"), opened),
    Action("reset_display", "Reset display", "View", "R", lambda app: _look(app, "reset"), opened),
    Action("keep", "Keep settings as B", "Compare", "K", lambda app: app.model.sides.keep(), opened,
           tooltip="Keep modules, parameters, kernels, network and window as B; further changes affect A"),
    Action("swap", "Take B's settings for A", "Compare", "Shift+K", lambda app: app.model.sides.take_second(), second),
    *(
        Action(f"b_{which.replace(' ', '_')}", f"B: {which}", "Compare", key,
               lambda app, which=which: app.model.comparison.with_neighbor(which), opened,
               lambda app, which=which: app.model.comparison.neighbor == which, "A's layer in that frame")
        for which, key in zip(NEIGHBORS, ("P", "Shift+P", "Alt+P"), strict=True)
    ),
    Action("follow", "B along motion vectors", "Compare", "V", lambda app: _toggle(app.model.comparison, "follows"),
           needs(lambda model: model.comparison.neighbor, "only where B is a frame before or after"),
           lambda app: app.model.comparison.follows),
    Action("b_from", "B from a folder …", "Compare", "Ctrl+K", _take_b, opened,
           tooltip="Another sequence, an output or stage dump of gffe run, or a folder of kernels"),
    Action("copy_command", "Copy A's command line", "Compare", "Alt+K", _copy_command, opened,
           tooltip="Copy the command gffe run … with the present settings"),
    Action("copy_command_b", "Copy B's command line", "Compare", "Alt+Shift+K",
           lambda app: _copy_command(app, of_b=True), second),
    Action("flip", "Show B (hold)", "Compare", "B", lambda app: app.model.comparison.flip(True), opened,
           release=lambda app: app.model.comparison.flip(False)),
    *(
        Action(f"compare_{way}", WAYS[way].capitalize(), "Compare", key,
               lambda app, way=way: app.model.comparison.toggle(way), opened,
               lambda app, way=way: app.model.view.compare == way)
        for way, key in (("split", "W"), ("difference", "D"))
    ),
    *(
        Action(f"difference_{how}", f"Difference as {text}", "Compare", "M" if how == "mean" else "",
               lambda app, how=how: app.model.comparison.subtract(how), opened,
               lambda app, how=how: (app.model.view.compare, app.model.view.difference) == ("difference", how))
        for how, text in FORMULAS.items()
    ),
    Action("truth", "Show ground truth", "Compare", "T", lambda app: app.model.comparison.toggle_truth(), has_truth),
    Action("survey", "Measure all frames", "Find", "Alt+J",
           lambda app: app.show_survey(not app.model.survey.on), opened, lambda app: app.model.survey.on,
           tooltip="Every generated frame, in the background: for the plot, and for finding frames"),
    Action("worst", "Worst frame", "Find", "J", lambda app: app.find(app.model.survey.worst), partial(findable, False),
           tooltip="By the quantity that is plotted"),
    Action("next_worst", "Next worse frame", "Find", "Shift+J", lambda app: app.find(app.model.survey.next),
           partial(findable, False), tooltip="In the order of the last search"),
    Action("most_different", "Largest A–B difference", "Find", "Ctrl+J",
           lambda app: app.find(app.model.survey.most_different), partial(findable, True),
           tooltip="Frame where the plotted figure of A's and B's settings differs most; again: the next one"),
    *(
        Action(f"{which}_fault", f"{which.capitalize()} marked frame", "Find", key,
               lambda app, step=step: app.model.go_to_fault(step), opened,
               tooltip="Invalid pixels, repeated frames, uneven times, resets and cuts, and what the doctor marks")
        for which, key, step in (("next", "I", 1), ("previous", "Shift+I", -1))
    ),
    Action("worst_pixel", "Worst pixel", "Find", "Alt+W", lambda app: app.model.go_to_largest(), shows_error,
           tooltip="Pixel with the largest difference or error that is shown"),
    *(
        Action(f"plot {name}", f"Plot {quantity.label}", "Find", "",
               lambda app, name=name: setattr(app.model.survey, "quantity", name),
               checked=lambda app, name=name: app.model.survey.quantity == name)
        for name, quantity in QUANTITIES.items()
    ),
    Action("back", "Back to where the link was", "Find", "Backspace", lambda app: app.model.walk.back(), has_left),
    Action("reload_kernels", "Reload kernels", "Tools", "F5", lambda app: app.model.engine.reload_kernels()),
    Action("palette", "Command palette", "Tools", "Ctrl+P", lambda app: app.palette.open()),
    Action("doctor", "Examine the sequence", "Tools", "Ctrl+D", lambda app: app.examine(), recorded,
           tooltip="Find faults: conventions of motion, depth and cameras, and the order of frames"),
    Action("theme", "Light theme", "Tools", "Ctrl+T", _theme, checked=lambda app: app.model.settings.theme == "light"),
    Action("larger", "Larger interface", "Tools", "Ctrl+=", lambda app: app.scale_by(1.1)),
    Action("smaller", "Smaller interface", "Tools", "Ctrl+-", lambda app: app.scale_by(1 / 1.1)),
    Action("panels", "Hide panels", "Panels", "Ctrl+B", lambda app: app.docks.hide(),
           checked=lambda app: app.docks.hidden),
    Action("layout", "Default arrangement", "Panels", "", lambda app: app.docks.reset()),
    Action("help", "Keys and help", "Help", "?", lambda app: app.help.toggle(), anywhere=True),
)  # fmt: skip


# ---- actions of scripts: they take an argument --------------------------------------------------------------------


def _with(app: App, name: str) -> None:
    found = found_layer(app.model.contents, name)
    if found == app.model.view.a:
        raise GffeError(f"'{found}' is compared with itself (expected another layer)")
    app.model.comparison.with_layer(found)


def _show_plane(app: App, text: str) -> None:
    (plane,), spec = numbers(text, 1), app.model.contents.spec(app.model.view.a)
    if spec is None or plane not in range(1, spec.planes + 1):
        planes = 1 if spec is None else spec.planes
        raise GffeError(f"expected 1 to {planes}, which '{app.model.view.a}' has, got {text}")
    app.model.looks.choose_plane(spec.name, int(plane) - 1)


def _among(known: Iterable[str], what: str) -> Callable[[str], None]:
    """Return what refuses names that are not among those that are known."""

    def check(name: str) -> None:
        if name not in known:
            raise GffeError(f"{what} '{name}' (expected {', '.join(known)})")

    return check


def _compare(app: App, way: str) -> None:
    if reason := app.model.comparison.why_not(way):
        raise GffeError(reason)
    app.model.comparison.set(way)


def _split(app: App, text: str) -> None:
    (share,) = numbers(text, 1)
    app.model.view.split = min(max(share, 0.0), 1.0)


def _pick(app: App, text: str) -> None:
    if text == "none":
        app.model.pointing.pick(None)
        return
    (width, height), (x, y) = app.model.contents.size, numbers(text, 2)
    if not (0 <= x < width and 0 <= y < height):
        raise GffeError(f"expected a pixel inside {width}×{height}, got {text}")
    app.model.pointing.pick((int(x), int(y)))


def _mark(app: App, text: str) -> None:
    x, y, width, height = numbers(text, 4)
    app.model.pointing.mark((x, y), (x + width - 1, y + height - 1))


def _set(app: App, text: str) -> None:
    name, _, value = text.partition(" ")
    option, value, parameters = ALL.get(name), value.strip(), app.model.parameters
    assert option is not None  # as it was checked
    if reason := parameters.why_not(name):
        raise GffeError(f"{option.label}: {reason}")
    if value in ("on", "off") and option.is_module:
        parameters.switch(name, value == "on")
    else:
        parameters.set(name, _value(option, value))


def _value(option: Option, text: str) -> object:
    if option.kind in (int, float):
        return parsed(option, text)
    return text == "on" if option.kind is bool and text in ("on", "off") else text


SCRIPT = (
    Action("seek", "Go to a frame", _SCRIPT, "",
           lambda app, text: app.model.playback.seek(slot_of(text, app.model.playback)), opened,
           takes="FRAME: its number on the timeline, generated ones counted (9), or 4+1/2 (4+0: rendered frame 4)",
           check=frame_of),
    Action("layer", "Show a layer", _SCRIPT, "",
           lambda app, name: app.model.show_layer(found_layer(app.model.contents, name)), opened, takes="NAME"),
    Action("plane", "Show a plane of the layer", _SCRIPT, "", _show_plane, opened, takes="N, from 1"),
    Action("from", "B from a folder", _SCRIPT, "", lambda app, place: app.model.sides.load_b(place), opened,
           takes="FOLDER: another sequence, an output of gffe run, or kernels"),
    Action("with", "Compare with a layer", _SCRIPT, "", _with, opened, takes="NAME"),
    Action("compare", "Compare A with B", _SCRIPT, "", _compare, opened, takes=", ".join(WAYS),
           check=_among(WAYS, "no comparison is called")),
    Action("split", "Move the line of the wipe", _SCRIPT, "", _split, takes="SHARE of the width, 0 to 1",
           check=lambda text: numbers(text, 1)),
    Action("pixel", "Tell the story of a pixel", _SCRIPT, "", _pick, opened, takes="X,Y; none: no more",
           check=lambda text: text == "none" or numbers(text, 2)),
    Action("rectangle", "Tell the statistics of a rectangle", _SCRIPT, "", _mark, opened, takes="X,Y,WIDTH,HEIGHT",
           check=lambda text: numbers(text, 4)),
    Action("set", "Set a parameter or module", _SCRIPT, "", _set,
           takes="OPTION VALUE, which is on, off, a number or a choice",
           check=lambda text: _among(ALL, "unknown option")(text.partition(" ")[0])),
    Action("panel", "Bring a panel to the front", _SCRIPT, "", lambda app, name: app.docks.show(name), takes="NAME",
           check=_among(PANELS, "no panel is called")),
    Action("type", "Type into the command palette", _SCRIPT, "",
           lambda app, text: app.palette.close() if text == "none" else app.palette.open(text),
           takes="TEXT; none: close it"),
    Action("say", "Show a title over the picture", _SCRIPT, "",
           lambda app, text: setattr(app.model, "messages", [Message(text, "title")]), takes="TEXT"),
    Action("wait", "Let time pass", _SCRIPT, "", lambda app, text: app.director.wait(text),
           takes="SECONDS; done: until nothing is measured, examined or saved", check=seconds_of),
    Action("shot", "Save a picture of the window", _SCRIPT, "", lambda app, text: app.director.shoot(app, Path(text)),
           takes="FILE.png", check=lambda text: require_file(Path(text), "picture", (".png",))),
)  # fmt: skip


# ---- filling the table --------------------------------------------------------------------------------------------


def register(app: App) -> None:
    """Fill `app.actions`."""
    options = [action for name, option in ALL.items() for action in _of_option(name, option)]
    first = [action for action in ACTIONS if action.group not in _LAST]
    last = [action for action in ACTIONS if action.group in _LAST]
    for action in (*first, *options, *last, *map(_of_panel, app.docks.names), *SCRIPT):
        app.actions.register(action)


def _of_panel(name: str) -> Action:
    return Action(
        f"toggle {name}",
        name,
        "Panels",
        "",
        lambda app: app.docks.toggle(name),
        checked=lambda app: app.docks.panel(name).is_visible,
    )


def _of_option(name: str, option: Option) -> list[Action]:
    """Return a switch for a module, and an action for every choice."""

    def why_not(app: App) -> str | None:
        return app.model.parameters.why_not(name)

    def is_on(app: App) -> bool:
        return app.model.parameters.is_on(name)

    made = []
    if option.is_module:
        label, tooltip = option.label, option.sentence
        switch = lambda app: app.model.parameters.switch(name, not is_on(app))  # noqa: E731
        made.append(Action(f"{name} switch", label, "Modules", "", switch, why_not, is_on, tooltip))
    for choice, text in option.choices.items():
        made.append(
            Action(
                f"{name} choice {choice}",
                f"{option.label}: {choice}",
                "Parameters",
                "",
                lambda app, choice=choice: app.model.set(name, choice),
                why_not,
                lambda app, choice=choice: app.model.parameters.value(name) == choice,
                f"{text[:1].upper()}{text[1:]}.",
            )
        )
    return made


def register_layers(app: App) -> None:
    """Register an action for every new layer. Actions of layers that are not made now stay, disabled."""

    def why_not(name: str, app: App) -> str | None:
        return app.model.contents.why_absent(name) or app.model.contents.why_not(name)

    for spec in app.model.contents.layers:
        if f"layer {spec.name}" not in app.actions:
            app.actions.register(
                Action(
                    f"layer {spec.name}",
                    f"{spec.group}: {spec.label}",
                    LAYERS,
                    "",
                    lambda app, name=spec.name: app.model.show_layer(name),
                    partial(why_not, spec.name),
                    lambda app, name=spec.name: app.model.view.a == name,
                    spec.description,
                )
            )


# ---- menus --------------------------------------------------------------------------------------------------------


def menus(app: App) -> None:
    for group, actions in app.actions.grouped().items():
        if group == LAYERS:  # a panel of their own
            continue
        if imgui.begin_menu(f"{group}###menu {group}"):
            for action in actions:
                _item(app.actions, action)
            if group == "File":
                _file_menu(app.model)
            imgui.end_menu()


def _item(actions: Actions, action: Action) -> None:
    reason = actions.why_not(action.id)
    clicked, _ = imgui.menu_item(
        f"{action.label}###{action.id}", action.shortcut, bool(actions.checked(action.id)), reason is None
    )
    if reason or action.tooltip:
        imgui.set_item_tooltip(reason or action.tooltip)
    if clicked:
        actions.run(action.id)


def _file_menu(model: Model) -> None:
    imgui.separator()
    for label, scenes in (("Built-in scenes###scenes", SCENES), ("Situations###situations", SITUATIONS)):
        if imgui.begin_menu(label):
            for name, text in scenes.items():
                if imgui.menu_item_simple(f"{name}###scene {name}"):
                    model.open(name)
                imgui.set_item_tooltip(text)
            imgui.end_menu()
    if imgui.begin_menu("Recent###recent", bool(model.settings.recent)):
        for path in list(model.settings.recent):
            if imgui.menu_item_simple(printable(path)):
                model.open(path)
        imgui.end_menu()
