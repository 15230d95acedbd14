"""What a program sees of the package: its names, their types, and the functions that serve any image."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
from synthetic import Rect, Rects, camera

import gffe_cl
from gffe_cl import FrameEntry, Pipeline, RenderedFrame, SequenceWriter, named_channels, open_sequence

PACKAGE = Path(gffe_cl.__file__).parent


def test_the_stub_has_all_names_and_their_modules():
    """Type checkers read it in place of the module, which loads names on first use."""
    stub = (PACKAGE / "__init__.pyi").read_text()
    names = re.findall(r"^from gffe_cl\.([\w.]+) import (\w+) as \2$", stub, re.M)
    assert {name: module for module, name in names} == gffe_cl._HOME
    assert set(re.findall(r"^(\w+):", stub, re.M)) == {"__version__", "__all__"}
    assert (PACKAGE / "py.typed").exists()


def test_everything_public_is_annotated():
    """Parameters and what is returned, of functions and of public methods of classes."""
    missing = []
    for name in gffe_cl.__all__:
        value = getattr(gffe_cl, name)
        functions = {name: value} if inspect.isfunction(value) else _methods(value) if inspect.isclass(value) else {}
        for called, function in functions.items():
            signature = inspect.signature(inspect.unwrap(function))
            parameters = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
            missing += [f"{name}: {called}({p.name})" for p in parameters if p.annotation is p.empty]
            if called != "__init__" and signature.return_annotation is signature.empty:
                missing.append(f"{name}: {called}() -> …")
    assert not missing


def _methods(kind: type) -> dict:
    """Of its own: those that a program calls."""
    found = {}
    for name, member in vars(kind).items():
        member = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
        if name == "__init__" or not name.startswith("_"):
            found |= {name: member} if inspect.isfunction(member) else {}
    return found


def test_version_is_said_once():
    project = (PACKAGE.parent / "pyproject.toml").read_text()
    assert 'dynamic = ["version",' in project and "gffe_cl.__version__" in project


def test_metrics_of_what_is_shown():
    rng = np.random.default_rng(0)
    truth = rng.random((20, 30, 3)).astype(np.float32)
    noisy = np.clip(truth + rng.normal(0, 0.1, truth.shape), 0, 1)
    shown = [gffe_cl.to_display(image) for image in (truth, noisy)]
    error = np.square(shown[0] - shown[1]).mean(dtype=np.float64)
    assert gffe_cl.psnr(*shown) == pytest.approx(-10 * np.log10(error), abs=1e-3)
    assert gffe_cl.psnr(shown[0], shown[0]) == 100 and gffe_cl.ssim(shown[0], shown[0]) == pytest.approx(1)
    assert 0.3 < gffe_cl.ssim(*shown) < 0.99
    same = np.abs(shown[0] - shown[1]).max(-1) == 0
    assert np.isnan(gffe_cl.psnr(*shown, mask=same)) or gffe_cl.psnr(*shown, mask=same) == 100
    values = gffe_cl.to_display([0, 0.0031308, 0.5, 1, 9, np.nan])
    assert np.allclose(values, [0, 0.04045, 0.735, 1, 1, 0], atol=1e-3)


def moving(count=3, flipped=False):
    """Frames of a textured wall that the camera passes; `flipped`: motion vectors of the wrong sign."""
    scene = Rects([Rect((0, 0, 6), frequency=1.5), Rect((0.5, 0, 3), (0.8, 0.8), frequency=4)])
    views = [camera(96, 64, (0.15 * k, 0, 0)) for k in range(count)]
    frames = [
        scene.frame(views[k], k / 30, 96, 64, (views[max(k - 1, 0)], max(k - 1, 0) / 30), reset=k == 0)
        for k in range(count)
    ]
    for frame in frames if flipped else ():
        frame.motion = -frame.motion
    return frames


def test_frames_in_memory_are_checked():
    assert gffe_cl.check(moving()) is None
    assert "motion vectors" in gffe_cl.check(moving(flipped=True), exposure=1.0)
    assert gffe_cl.check(moving(1)).startswith("cannot tell whether the frames fit")  # nothing to compare with


def test_a_sequence_is_a_loop_over_its_rendered_frames(device, tmp_path):
    frames = moving()
    with SequenceWriter(tmp_path / "s", 96, 64, 30.0) as writer:
        for k, frame in enumerate(frames):
            entry = FrameEntry(f"{k}.exr", frame.time, reset=frame.reset, render_camera=frame.camera)
            writer.add(entry, named_channels(frame.color, frame.depth, frame.motion))
    pipeline = Pipeline(device, 96, 64)
    seen = []
    for frame in open_sequence(tmp_path / "s"):
        pipeline.submit(frame)
        seen.append(frame)
    assert [frame.time for frame in seen] == pytest.approx([frame.time for frame in frames])
    assert all(isinstance(frame, RenderedFrame) for frame in seen)
    assert np.array_equal(seen[1].depth, frames[1].depth)
