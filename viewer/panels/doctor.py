"""Doctor panel: faults of the open sequence. Its marks are also on the timeline."""

from __future__ import annotations

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from gffe_cl.engine.core.errors import printable
from . import widgets
from .interface import Interface

_RED, _AMBER, _GRAY = (0.97, 0.5, 0.45, 1.0), (0.9, 0.7, 0.3, 1.0), (0.6, 0.6, 0.62, 1.0)


def draw(app: Interface) -> None:
    model = app.model
    doctor = model.doctor
    widgets.action_button(app.actions, "doctor", icons.ICON_FA_STETHOSCOPE)
    imgui.same_line()
    if doctor is None:
        widgets.hint("Examine motion, depth, cameras and colors for faults, and propose repairs")
        return
    if not doctor.done:
        widgets.hint("examining motion, depth, cameras and colors …")
    elif doctor.problem:
        widgets.hint("could not be examined")
        _colored(_RED, doctor.problem)
    elif not doctor.findings:
        widgets.hint("everything fits")
    else:
        widgets.hint(f"{len(doctor.findings)} finding{'s' * (len(doctor.findings) > 1)}")
    _findings(doctor)
    if model.marks:
        widgets.heading("Frames in the wrong place")
        with widgets.in_rows() as row:
            for frame, reason in model.marks.items():
                row(imgui.calc_text_size(f"{frame}").x)
                if imgui.text_link(f"{frame}###mark {frame}"):
                    model.playback.seek(frame * (model.n + 1))
                widgets.tooltip(f"rendered frame {frame} {reason}")
    if any(finding.fix for finding in doctor.findings):
        imgui.separator()
        widgets.hint(printable(f"gffe check {model.source.target} --fix OUT  repairs it"))


def _findings(doctor) -> None:
    if not doctor.findings:
        return
    from gffe_cl.captures.doctor.findings import FAULT, NOTE  # loaded by now

    colors = {FAULT: _RED, NOTE: _AMBER}
    for finding in doctor.findings:
        _colored(colors.get(finding.kind, _GRAY), finding.kind)
        imgui.text_wrapped(str(finding))


def _colored(color, text: str) -> None:
    imgui.push_style_color(imgui.Col_.text, color)
    imgui.text_wrapped(text)
    imgui.pop_style_color()
