"""Public names of the package: the module of each, loaded on first use because importing the package must not load a
driver, and removed names with what to use instead."""

import sys
from importlib import import_module
from typing import Any

from gffe_cl.engine.core.errors import GffeError

__version__ = "0.2.0"

# Module of each name, without "gffe_cl.".
HOME = {
    "Camera": "engine.frame.camera",
    "predict_camera": "engine.frame.camera",
    "predict_camera_at": "engine.frame.camera_prediction",
    "depth_from_device": "engine.frame.conventions",
    "depth_from_distance": "engine.frame.conventions",
    "motion_from_ndc": "engine.frame.conventions",
    "motion_from_uv": "engine.frame.conventions",
    "motion_from_unreal": "engine.frame.conventions",
    "FrameFormat": "engine.frame.frame_format",
    "Device": "engine.opencl.device",
    "DeviceInfo": "engine.opencl.device",
    "list_devices": "engine.opencl.device",
    "open_device": "engine.opencl.device",
    "prepare_runtimes": "engine.opencl.runtimes",
    "SharingSupport": "engine.opencl.sharing",
    "sharing_support": "engine.opencl.sharing",
    "MemorySharing": "engine.opencl.sharing",
    "GffeError": "engine.core.errors",
    "BadPixels": "engine.frame.rendered_frame",
    "Overlays": "engine.frame.rendered_frame",
    "RenderedFrame": "engine.frame.rendered_frame",
    "ExtrapolatedFrame": "engine.pipeline.made_frame",
    "Options": "engine.options",
    "OPTIONS": "engine.options",
    "Pipeline": "engine.pipeline.pipeline",
    "PresentedFrame": "engine.pipeline.made_frame",
    "open_capture": "captures.formats",
    "FrameEntry": "captures.sequence",
    "Sequence": "captures.sequence",
    "SequenceWriter": "captures.sequence",
    "named_channels": "captures.sequence",
    "open_sequence": "captures.sequence",
    "present": "engine.stages.presentation",
    "record": "captures.offline.recording",
    "Pacer": "engine.pipeline.pacing",
    "check": "captures.doctor.diagnose",
    "psnr": "lab.metrics",
    "ssim": "lab.metrics",
    "to_display": "engine.frame.transfer_function",
    "Window": "engine.frame.window",
    "adaptive_window": "engine.frame.window",
    "fixed_window": "engine.frame.window",
    "nearest_depth": "engine.frame.window",
    "Jitter": "engine.frame.window",
}

__all__ = ["__version__", *HOME]

# Names of the API stand alone, commands and their options as they were typed: "gffe bench", "gffe bench --budget".
GONE: dict[str, str] = {
    "gffe calibrate": "write the cameras with the capture, or find them by cv2.solvePnP (docs/formats.md).",
    "gffe bench --methods": "`gffe eval` has the quality and the time of each method.",
    "gffe eval --budget": "the regions of results.json have pixels and PSNR, `--regions` prints them.",
    "gffe eval --encode": "`gffe render --ground-truth --encode` writes a sequence that `gffe eval` measures.",
    "gffe eval --late-warp": "turn the camera of Pipeline.extrapolate at the rendered frame's own time.",
    "gffe eval --turn-rate": "render a scene whose camera turns, such as forest, or measure a sequence of your own.",
    "gffe eval --upscale": "`gffe run --upscale` and `gffe compare` measure upscaling.",
    "GlSharing": "import memory of Vulkan by MemorySharing, or pass NumPy arrays to submit.",
    "gffe check --html": "`--json FILE` has all findings and residuals.",
    "gffe check --fix": "`--format-out FILE` writes the format that undoes the faults, for `gffe import --format`.",
    "gffe check --only": "remove the other fields from the file of `--format-out`.",
    "gffe check --except": "remove its fields from the file of `--format-out`.",
    "Stepper": "choose a preset (gffe bench prints what each costs); Pipeline.change_options works with other options.",
    "choose_options": "choose a preset: gffe bench prints what each costs.",
    "gffe bench --budget": "gffe bench prints what each preset costs.",
    "attach": "record(pipeline, folder) writes rendered frames that `gffe view FOLDER` follows.",
    **dict.fromkeys(
        ("gffe export --frames", "gffe export --count", "gffe export --size"),
        "the example renders its own frames; `gffe run` takes those of a scene or a capture.",
    ),
    **{
        f"gffe {command} --follow-links": "make a link of the file system in the capture's folder: these are followed."
        for command in ("bench", "check", "compare", "eval", "import", "run", "view")
    },
    "gffe train --data-only": "the command makes its clips first, and continues from them.",
    "gffe view --attach": "gffe_cl.record(pipeline, folder) in the program, and `gffe view FOLDER` beside it.",
    "gffe view --last": "gffe_cl.record(pipeline, folder, most=…) in the program, and `gffe view FOLDER` beside it.",
    "gffe view --measure": "the panel *Timings* shows what frames take, `gffe bench` what each stage costs.",
    "gffe view --json": "`gffe bench --json FILE` has the times of each stage.",
    "gffe bench --host": "docs/tools/compare_speed.py --host times the calling thread.",
    "gffe bench --lanes": "docs/tools/count_traffic.py --lanes counts both forms of the kernels.",
    "gffe bench --traffic": "docs/tools/count_traffic.py counts bytes and instructions.",
}


def removal(name: str) -> str | None:
    """Return the error for a removed name, None for any other."""
    return f"{name} was removed: {GONE[name]}" if name in GONE else None


def __getattr__(name: str) -> Any:
    """Return a public name of the package. Raises GffeError for a removed one."""
    if removed := removal(name):
        raise GffeError(removed)
    if name not in HOME:
        raise AttributeError(f"module 'gffe_cl' has no attribute '{name}'")
    value = getattr(import_module(f"gffe_cl.{HOME[name]}"), name)
    setattr(sys.modules["gffe_cl"], name, value)
    return value


def __dir__() -> list[str]:
    return sorted({*vars(sys.modules["gffe_cl"]), *__all__})
