"""Removed names of the API, of commands and of options, each with a sentence that says what to use instead.

Names of the API stand alone, commands and their options as they were typed: "gffe bench", "gffe bench --budget".
"""

GONE: dict[str, str] = {
    "gffe calibrate": "write the cameras with the capture, or find them by cv2.solvePnP (docs/formats.md).",
    "gffe bench --methods": "`gffe eval` has the quality and the time of each method.",
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
