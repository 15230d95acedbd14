"""Doctor panel: faults of the open sequence. Its marks are also on the timeline."""

from __future__ import annotations

from imgui_bundle import ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from gffe_cl.engine.core.errors import printable
from ..state.model import Model
from . import widgets
from .app import App

_AMBER, _GRAY = ImVec4(0.9, 0.7, 0.3, 1.0), ImVec4(0.6, 0.6, 0.62, 1.0)


def draw(app: App) -> None:
    model = app.model
    doctor = model.document.doctor
    widgets.action_button(app.actions, "doctor", icons.ICON_FA_STETHOSCOPE)
    imgui.same_line()
    if doctor is None:
        widgets.hint("Examine motion, depth, cameras and colors for faults, and propose repairs")
        return
    if not doctor.done:
        widgets.hint("examining motion, depth, cameras and colors …")
    elif doctor.problem:
        widgets.hint("could not be examined")
        widgets.colored(widgets.red(), doctor.problem)
    elif not doctor.findings:
        widgets.hint("everything fits")
    else:
        widgets.hint(f"{len(doctor.findings)} finding{'s' * (len(doctor.findings) > 1)}")
    _findings(model, doctor)
    if model.document.marks:
        widgets.heading("Frames in the wrong place")
        with widgets.in_rows() as row:
            for frame, reason in model.document.marks.items():
                row(imgui.calc_text_size(f"{frame}").x)
                if imgui.text_link(f"{frame}###mark {frame}"):
                    model.playback.seek(frame * (model.n + 1))
                widgets.tooltip(f"rendered frame {frame} {reason}")
    if doctor.converts:
        imgui.separator()
        command = f"gffe check {model.source.target} --format-out FOUND.json"
        widgets.hint(printable(f"{command}  writes the format that undoes this, for gffe import --format"))


def _findings(model: Model, doctor) -> None:
    if not doctor.findings:
        return
    from gffe_cl.captures.doctor.findings import FAULT, NOTE  # loaded by now

    colors = {FAULT: widgets.red(), NOTE: _AMBER}
    for finding in doctor.findings:
        widgets.colored(colors.get(finding.kind, _GRAY), finding.kind)
        imgui.text_wrapped(str(finding))
        with widgets.in_rows() as row:
            for name, (frame, x, y) in finding.places.items():
                text = f"{name} in frame {frame}"
                row(imgui.calc_text_size(text).x)
                if imgui.text_link(f"{text}###place {finding.name} {name}"):
                    model.walk.follow_input(frame, (x, y))
                widgets.tooltip(f"rendered frame {frame}, pixel ({x}, {y}) of the input")
