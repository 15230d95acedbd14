"""Table of actions, for menus, help and the command palette."""

from __future__ import annotations

from functools import partial

from imgui_bundle import imgui

from gffe_cl.captures.scenes import SCENES, SITUATIONS
from gffe_cl.engine.core.errors import printable
from gffe_cl.engine.options import Option
from ..engine.figures import QUANTITIES, REGIONS
from ..state import copying, saving
from ..state.actions import Action
from ..state.comparing import FORMULAS
from ..state.model import Model
from ..state.parameters import ALL
from ..state.presets import Kept, command_line
from .workspace import Workspace

_EXPOSURE_STEP = 0.5
LAYERS = "Layer"  # group of actions


def register(app: Workspace) -> None:
    """Fill `app.actions`."""
    model = app.model

    def add(id, label, group, shortcut, run, enabled=lambda: None, **more):
        app.actions.register(Action(id, label, group, shortcut, run, enabled, **more))

    def opened():
        return None if model.source is not None else "nothing is open"

    def live():
        return opened() or (None if model.source.live else "only in a built-in scene")

    def recorded():
        return opened() or (None if not model.source.live else "only of recorded frames")

    def on_disk():
        return opened() or (None if model.source.target else "only of a sequence on disk or a scene")

    def savable():
        return opened() or ("something is being saved" if model.saving.work is not None else None)

    def playback(name, *arguments):
        return lambda: getattr(model.playback, name)(*arguments)

    def look(change, *values):
        return lambda: change(model.view.a, *values)

    add("open", "Open …", "File", "Ctrl+O", app.open_dialog)
    add("open_path", "Open by path …", "File", "Ctrl+Shift+O", lambda: app.open_path.open(model.open))
    add("reload", "Reload frames", "File", "Ctrl+R", model.reload, on_disk)
    add("save_png", "Save picture as PNG", "File", "Ctrl+S", partial(model.saving.start, saving.PictureWork), savable)
    add("save_exr", "Save layers as EXR", "File", "Ctrl+E", partial(model.saving.start, saving.LayersWork), savable)
    add("save_video", "Save playback as MP4", "File", "Ctrl+M", partial(model.saving.start, saving.VideoWork), savable)
    add("save_into", "Save into …", "File", "",
        lambda: app.open_dialog("Save into a folder", model.saving.choose_folder),
        tooltip="Choose the folder of what is saved from now on")  # fmt: skip
    add("copy_saved", "Copy the path of the last save", "File", "",
        lambda: app.copy(str(model.saving.saved)),
        lambda: None if model.saving.saved else "nothing has been saved")  # fmt: skip
    add("legends", "Legends in saved pictures", "File", "",
        lambda: setattr(model.settings, "legends", not model.settings.legends),
        checked=lambda: model.settings.legends)  # fmt: skip
    add("quit", "Quit", "File", "Ctrl+Q", app.close, anywhere=True)

    add("play", "Play / stop", "Playback", "Space", playback("toggle"), opened)
    add("step", "Next frame", "Playback", "Right", playback("step", 1), opened, repeat=True)
    add("step_back", "Previous frame", "Playback", "Left", playback("step", -1), opened, repeat=True)
    add(
        "next_rendered",
        "Next rendered frame",
        "Playback",
        "Shift+Right",
        playback("step_rendered", 1),
        opened,
        repeat=True,
    )
    add("previous_rendered", "Previous rendered frame", "Playback", "Shift+Left", playback("step_rendered", -1), opened,
        repeat=True)  # fmt: skip
    add("first", "First frame", "Playback", "Home", playback("home"), opened)
    add("last", "Last frame", "Playback", "End", playback("end"), opened)
    add("stop", "Stop computing", "Playback", "Ctrl+.", model.stop_computing,
        lambda: opened() or (None if model.stopped or model.showing.is_waiting else "nothing is being computed"),
        tooltip="Cancel the current picture. Press again to resume")  # fmt: skip
    add("only_generated", "Only generated frames", "Playback", "Shift+G",
        lambda: setattr(model.playback, "only_generated", not model.playback.only_generated), opened,
        checked=lambda: model.playback.only_generated,
        tooltip="While it plays, the generated frame before stands in for each rendered one")  # fmt: skip
    add("set_in", "Set in point", "Playback", "[", playback("set_in"), opened)
    add("set_out", "Set out point", "Playback", "]", playback("set_out"), opened)
    add("clear_points", "Clear in and out points", "Playback", "\\", playback("clear_points"), opened)

    add("fit", "Fit", "View", "F", lambda: setattr(model.framing, "due", True), opened)
    add("one_to_one", "1 : 1", "View", "Ctrl+0", lambda: setattr(model.view, "zoom", 1.0), opened)
    add("zoom_in", "Zoom in", "View", "+", lambda: model.framing.zoom_in(app.canvas_size, model.pointing.picked),
        opened, also=("=",), tooltip="Zoom in at the picked pixel if it is seen, else at the middle")  # fmt: skip
    add("zoom_out", "Zoom out", "View", "-", lambda: model.framing.zoom(0.5), opened)
    add("next_layer", "Next layer", "View", "Down", lambda: model.walk.next_layer(1), opened, repeat=True)
    add("previous_layer", "Previous layer", "View", "Up", lambda: model.walk.next_layer(-1), opened, repeat=True)
    add("next_channel", "Next channel", "View", "C", look(model.looks.next_channel), opened)
    add("overview", "Overview of all layers", "View", "O",
        lambda: setattr(model, "overview", not model.overview), opened,
        checked=lambda: model.overview)  # fmt: skip
    add("disocclusions", "Disocclusions", "View", "X",
        lambda: model.disocclusions.switch(not model.disocclusions.on), opened, checked=lambda: model.disocclusions.on,
        tooltip="Over the picture: pixels of generated frames that were out of screen or hidden")  # fmt: skip
    add("mark_invalid", "Mark invalid pixels", "View", "",
        lambda: setattr(model.view, "mark_invalid", not model.view.mark_invalid),
        checked=lambda: model.view.mark_invalid,
        tooltip="A pattern over NaN, infinity, and pixels that the input has invalid")  # fmt: skip
    add("brighter", "Brighter", "View", "E", look(model.looks.expose, _EXPOSURE_STEP), opened)
    add("darker", "Darker", "View", "Shift+E", look(model.looks.expose, -_EXPOSURE_STEP), opened)
    add("normalize", "Fit range to the picture", "View", "N", look(model.looks.fit), opened)
    add("reset_display", "Reset display", "View", "R", look(model.looks.reset), opened)
    _copying(app, add, savable)
    _comparing(app, add, opened)
    _finding(app, add, opened, savable)
    add("fly", "Fly the camera", "Camera", "G", model.flights.toggle, live, checked=lambda: model.flying,
        tooltip="W A S D and Q E move, the right mouse button turns, Shift is faster")  # fmt: skip
    add("home_camera", "Back to the scene's camera", "Camera", "H", model.stop_flying, live)

    for name, option in ALL.items():
        _register_parameter(app, name, option)
    add("undo", "Undo a setting", "Parameters", "Ctrl+Z", model.undo.undo,
        lambda: None if model.undo.done else "no setting was changed")  # fmt: skip
    add("redo", "Redo a setting", "Parameters", "Ctrl+Shift+Z", model.undo.redo,
        lambda: None if model.undo.undone else "nothing was undone")  # fmt: skip

    add("reload_kernels", "Reload kernels", "Tools", "F5", model.engine.reload_kernels)
    add("palette", "Command palette", "Tools", "Ctrl+P", app.palette.open)
    add(
        "doctor",
        "Examine the sequence",
        "Tools",
        "Ctrl+D",
        app.examine,
        recorded,
        tooltip="Find faults: conventions of motion, depth and cameras, and the order of frames",
    )
    add("theme", "Light theme", "Tools", "Ctrl+T", lambda: _theme(app), checked=lambda: model.settings.theme == "light")
    add("larger", "Larger interface", "Tools", "Ctrl+=", lambda: app.scale_by(1.1))
    add("smaller", "Smaller interface", "Tools", "Ctrl+-", lambda: app.scale_by(1 / 1.1))
    add("panels", "Hide panels", "Panels", "Ctrl+B", app.docks.hide, checked=lambda: app.docks.hidden)
    for name in app.docks.names:
        add(f"panel {name}", name, "Panels", "", partial(app.docks.toggle, name),
            checked=lambda name=name: app.docks.panel(name).is_visible)  # fmt: skip
    add("layout", "Default arrangement", "Panels", "", app.docks.reset)

    add("help", "Keys and help", "Help", "?", app.help.toggle, anywhere=True)


def _copying(app: Workspace, add, savable) -> None:
    """Register the actions that copy to the clipboard."""
    model = app.model

    def value():
        at, stale = model.values
        return "" if at is None or stale else copying.value_of(model.contents, model.captions.frame, model.view.a, at)

    def no_numbers():
        image = model.contents.image(model.view.a)
        if model.selection.rectangle is None:
            return "drag with Shift to draw a rectangle"
        fits = image is not None and image.shape[:2] == model.contents.size[::-1]
        return None if fits else "only of layers as large as the display"

    def numbers():
        image, rectangle = model.contents.image(model.view.a), model.selection.rectangle
        assert image is not None and rectangle is not None  # as there are numbers
        return copying.numbers_of(image, rectangle)

    add("copy_value", "Copy the value", "File", "Ctrl+C", lambda: app.copy(value()),
        lambda: None if value() else "point at a pixel, or pick one",
        tooltip="Frame, layer, pixel and value")  # fmt: skip
    add("copy_layer", "Copy the layer's numbers", "File", "Ctrl+Alt+C", lambda: app.copy(numbers()), no_numbers,
        tooltip="Copy the numbers of the rectangle's pixels row by row, to paste them into a table")  # fmt: skip
    add(
        "copy_picture",
        "Copy the picture",
        "File",
        "Ctrl+Shift+C",
        partial(model.saving.start, copying.CopyWork),
        savable,
    )


def _comparing(app: Workspace, add, opened) -> None:
    """Register the actions that compare A with B."""
    model = app.model

    def no_second():
        return None if model.kept.b is not None else "no settings are kept as B"

    def no_settings():
        reason = no_second()
        return reason or ("B is pictures, not settings" if model.kept.b and model.kept.b.place else None)

    def copy(kept: Kept | None = None):
        setup = model.setup if kept is None else kept.setup(model.n)
        app.copy(printable(command_line(setup, model.source, model.plan.seed)))

    add("keep", "Keep settings as B", "Compare", "K", model.sides.keep, opened,
        tooltip="Keep modules, parameters, kernels, network and window as B; further changes affect A")  # fmt: skip
    add("swap", "Take B's settings for A", "Compare", "Shift+K", model.sides.take_second,
        lambda: opened() or no_settings())  # fmt: skip
    add("b_from", "B from a folder …", "Compare", "Ctrl+K",
        lambda: app.open_dialog("Compare with a sequence, an output of gffe run, or kernels", model.sides.take_b_from),
        opened,
        tooltip="Another sequence, an output or stage dump of gffe run, or a folder of kernels")  # fmt: skip
    add("b_baseline", "B from stored figures …", "Compare", "Alt+B",
        lambda: app.open_dialog("Compare with stored figures", model.sides.take_b_from, of_file=True),
        opened,
        tooltip="A baseline that the viewer has stored, or the JSON of gffe compare: its figures are B's")  # fmt: skip
    add("copy_command", "Copy A's command line", "Compare", "Alt+K", copy, opened,
        tooltip="Copy the command gffe run … with the present settings")  # fmt: skip
    add("copy_command_b", "Copy B's command line", "Compare", "Alt+Shift+K",
        lambda: copy(model.kept.b), lambda: opened() or no_settings())  # fmt: skip
    add("flip", "Show B (hold)", "Compare", "B", model.comparison.flip, opened, hold=True)
    for way, text, key in (
        ("split", "Split wipe", "W"),
        ("difference", "Difference", "D"),
        ("error", "Error map", "M"),
    ):
        add(f"compare_{way}", text, "Compare", key, partial(model.comparison.toggle, way),
            lambda way=way: opened() or model.comparison.why_not(way),
            checked=lambda way=way: model.view.compare == way)  # fmt: skip
    for how, text in FORMULAS.items():
        add(f"difference_{how}", f"Difference as {text}", "Compare", "", partial(model.comparison.subtract, how),
            lambda: opened() or model.comparison.why_not("difference"),
            checked=lambda how=how: model.view.difference == how)  # fmt: skip
    add("truth", "Show ground truth", "Compare", "T", model.comparison.toggle_truth,
        lambda: opened() or model.contents.why_not("truth"))  # fmt: skip


def _finding(app: Workspace, add, opened, savable) -> None:
    """Register the actions that find wrong frames, regions and pixels."""
    model, survey, regions = app.model, app.model.survey, app.model.regions
    add("survey", "Measure all frames", "Find", "Alt+J", lambda: app.show_survey(not survey.on),
        lambda: opened(), checked=lambda: survey.on,
        tooltip="Every generated frame, in the background: for the plot, and for finding frames")  # fmt: skip
    add("save_figures", "Store figures as a baseline", "Find", "Alt+Shift+J",
        lambda: model.saving.start(lambda subject: saving.FiguresWork(subject, survey.document())),
        lambda: savable() or (None if survey.figures(survey.a) else "no frame is measured yet"),
        tooltip="A's figures that are known, as JSON. Alt+B shows them as B's later")  # fmt: skip
    for id, text, key, find, tooltip in (
        ("worst", "Worst frame", "J", survey.worst, "By the quantity that is plotted"),
        ("next_worst", "Next worse frame", "Shift+J", survey.next, "In the order of the last search"),
        ("most_different", "Largest A–B difference", "Ctrl+J", survey.most_different,
         "Frame where the plotted figure of A's and B's settings differs most; again: the next one"),
    ):  # fmt: skip
        difference = id == "most_different"
        add(id, text, "Find", key, partial(app.find, find),
            lambda difference=difference: opened() or survey.why_not(difference), tooltip=tooltip)  # fmt: skip
    add("worst_pixel", "Worst pixel", "Find", "Alt+W", lambda: setattr(model.worst, "due", True),
        lambda: opened() or model.worst.why_not(),
        tooltip="Of this frame, by A and B if they are compared, else by ground truth; again: the next")  # fmt: skip
    for name, quantity in QUANTITIES.items():
        add(f"plot {name}", f"Plot {quantity.label}", "Find", "", partial(setattr, survey, "quantity", name),
            checked=lambda name=name: survey.quantity == name)  # fmt: skip
    add("regions", "Regions of errors", "Find", "Alt+R", app.switch_regions,
        lambda: opened() or regions.why_not(), checked=lambda: regions.on,
        tooltip="Where errors are counted, over the picture")  # fmt: skip
    for name, text in REGIONS.items():
        add(f"region {name}", f"Only region: {name}", "Find", "", partial(regions.see_only, name),
            lambda: opened() or regions.why_not(), checked=lambda name=name: regions.only == name,
            tooltip=f"{text[:1].upper()}{text[1:]}")  # fmt: skip
    add("next_invalid", "Next invalid pixel", "Find", "Shift+N",
        lambda: model.walk.go_to_pixel(model.invalid.next(model.pointing.picked)),
        lambda: opened() or (None if model.invalid.count else "no NaN, infinity or invalid input in this picture"),
        tooltip="NaN, infinity, and pixels that the input has invalid; row by row")  # fmt: skip
    add("back", "Back to where the link was", "Find", "Backspace", model.walk.back,
        lambda: opened() or (None if model.walk.can_go_back else "no link was followed"))  # fmt: skip
    add("forget_rectangle", "Forget the rectangle", "Find", "", model.selection.forget,
        lambda: opened() or (None if model.selection.rectangle else "drag with Shift to draw one"))  # fmt: skip


def _register_parameter(app: Workspace, name: str, option: Option) -> None:
    """Register a switch for a module, an action for every choice, and for a number one that asks for it."""
    model, parameters = app.model, app.model.parameters

    def add(id, label, group, run, checked=lambda: None, tooltip=option.sentence):
        reason = partial(parameters.why_not, name)
        app.actions.register(Action(f"{name} {id}", label, group, "", run, reason, checked, tooltip))

    if option.is_module:
        label, tooltip = option.off_label or option.label, option.off_sentence or option.sentence
        on = partial(parameters.is_on, name)
        add("switch", label, "Modules", lambda: parameters.switch(name, not on()), on, tooltip)
    for choice, text in option.choices.items():
        add(f"choice {choice}", f"{option.label}: {choice}", "Parameters", partial(model.set, name, choice),
            lambda choice=choice: parameters.value(name) == choice, f"{text[:1].upper()}{text[1:]}.")  # fmt: skip
    if option.kind in (int, float):
        add("number", f"{option.label} …", "Parameters", partial(app.palette.ask, name))


def register_layers(app: Workspace) -> None:
    """Register an action for every new layer. Actions of layers that are not made now stay, disabled."""
    model = app.model
    for spec in model.contents.layers:
        if f"layer {spec.name}" in app.actions:
            continue
        name = spec.name
        app.actions.register(
            Action(
                f"layer {name}",
                f"{spec.group}: {spec.label}",
                LAYERS,
                "",
                partial(model.show_layer, name),
                partial(_why_no_layer, model, name),
                lambda name=name: model.view.a == name,
                spec.description,
            )
        )


def _why_no_layer(model: Model, name: str) -> str | None:
    return model.contents.why_absent(name) or model.contents.why_not(name)


def _theme(app: Workspace) -> None:
    app.model.settings.theme = "dark" if app.model.settings.theme == "light" else "light"


def menus(app: Workspace) -> None:
    for group, actions in app.actions.grouped().items():
        if group == LAYERS:  # a panel of their own
            continue
        if imgui.begin_menu(f"{group}###menu {group}"):
            for action in actions:
                _item(app.actions, action)
            if group == "File":
                _file_menu(app.model)
            imgui.end_menu()


def _item(actions, action) -> None:
    reason = action.enabled()
    clicked, _ = imgui.menu_item(
        f"{action.label}###{action.id}", action.shortcut, bool(action.checked()), reason is None
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
