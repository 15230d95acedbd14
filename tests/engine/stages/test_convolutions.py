"""The network's convolutions as kernels: against onnxruntime, bit by bit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from network_stages import made_before_the_device_begins, made_stages
from parameters import few
from scn_models import integer_model
from synthetic import Rect, Rects, camera

from gffe_cl import Options, Pipeline
from gffe_cl.engine.inference import network as inference
from gffe_cl.engine.inference.network import OPENCL, cpu_model, load_network

SIZES = [(61, 37), (1, 1), (130, 70), (20, 150)]


@pytest.fixture(params=[False, True], ids=["integers", "floats"])
def form(request, device, monkeypatch):
    """Both forms of the kernels' sums."""
    monkeypatch.setitem(device.__dict__, "float_sums", request.param)


def inputs(board, seed=0):
    """Frames and candidates that use the whole range of the network's."""
    width, height = board.sizes.of("network")
    rng = np.random.default_rng(seed)
    frames = rng.random((8, height, width), np.float32)
    frames[:6] *= np.kron(rng.random((height // 16, width // 16), np.float32), np.ones((16, 16), np.float32))
    return frames, rng.normal(0, 1.5, (16, height // 2, width // 2)).astype(np.float32)


def stages(device, size, network):
    board, correction, step = made_stages(device, size)
    correction.use(network)
    board.stages["shading_trend"].upload("changed", np.ones(1, np.int32))
    return board, correction, step


def judged(board, correction, step, frames, candidates):
    """Judgement of the kernels."""
    board.stages["network_input"].upload("frames", frames)
    board.stages["shading_flow"].upload("candidates", candidates)
    board.stages["convolutions"].extrapolated(step)
    return correction.read("judgement")


def by_onnxruntime(path, frames, candidates):
    judgement = np.empty((20, *candidates.shape[1:]), np.float32)
    assert load_network(path).run(frames, candidates, judgement) == 0
    return judgement


def require_equal(board, correction, step, path, frames, candidates):
    found = judged(board, correction, step, frames, candidates)
    assert np.array_equal(found, by_onnxruntime(path, frames, candidates)) and np.isfinite(found).all()


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize("size", SIZES)
def test_the_packages_network_equals_onnxruntime(device, default_model, size):
    path = cpu_model(default_model())
    network = load_network(path, OPENCL)
    board, correction, step = stages(device, size, network)
    require_equal(board, correction, step, path, *inputs(board))


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize(
    ("channels", "seen", "zeros"),
    [
        ((16,), 16, ()),
        ((20, 44, 12), 32, ()),
        ((16, 8, 24, 36), 48, (0,)),
        ((28, 16), 16, (255,)),
        ((16, 24), 16, (0, 255)),
    ],
)
def test_networks_of_any_width_and_depth(device, tmp_path, channels, seen, zeros):
    """... with zero points at both ends."""
    path = integer_model(tmp_path / "m.onnx", channels, seen, zeros=zeros)
    network = load_network(path, OPENCL)
    board, correction, step = stages(device, (70, 40), network)
    require_equal(board, correction, step, path, *inputs(board))


def test_sums_up_to_the_limit(device, tmp_path, monkeypatch):
    """Weights whose sums of products reach 2^24 nearly: both forms of sums are equal. Without VNNI, onnxruntime takes
    smaller weights alone."""
    network = load_network(integer_model(tmp_path / "m.onnx", (16,), 48, zeros=(128,), largest=114), OPENCL)
    (layer,) = (layer for layer in network.layers.layers if layer.kind == "convolution")
    largest = 255 * np.abs(layer.weights.astype(int)).sum((1, 2, 3)).max()
    assert 0.99 < largest / 2**24 < 1
    made = []
    for in_floats in (False, True):
        monkeypatch.setitem(device.__dict__, "float_sums", in_floats)
        board, correction, step = stages(device, (40, 24), network)
        made.append(judged(board, correction, step, *(np.full_like(array, 40) for array in inputs(board))))
    assert np.array_equal(*made) and np.isfinite(made[0]).all() and np.ptp(made[0]) > 0


@pytest.mark.usefixtures("form")
def test_invalid_inputs_become_bytes(device, default_model):
    """... the same ones as in onnxruntime: NaN and −∞ the least, ∞ the largest. So the judgement is finite, and pixels
    without one are none."""
    path = cpu_model(default_model())
    network = load_network(path, OPENCL)
    board, correction, step = stages(device, (80, 64), network)
    frames, candidates = inputs(board)
    rng = np.random.default_rng(1)
    for array in (frames, candidates):
        for value in (np.nan, np.inf, -np.inf, 3e38, -3e38):
            array[tuple(rng.integers(0, array.shape, (6, 3)).T)] = value
    require_equal(board, correction, step, path, frames, candidates)
    assert correction.unusable_pixels == 0


def test_still_frames_are_left_alone(device, default_model):
    """Nobody reads their judgement, unless the whole image is asked for."""
    network = load_network(cpu_model(default_model()), OPENCL)
    board, correction, step = stages(device, (40, 24), network)
    frames, candidates = inputs(board)
    first = judged(board, correction, step, frames, candidates)
    board.stages["shading_trend"].upload("changed", np.zeros(1, np.int32))
    assert np.array_equal(judged(board, correction, step, 1 - frames, candidates), first)
    correction.with_refined = True
    assert not np.array_equal(judged(board, correction, step, 1 - frames, candidates), first)


def test_a_network_that_is_replaced(device, default_model, tmp_path):
    """By one of other widths, and by onnxruntime."""
    path = cpu_model(default_model())
    board, correction, step = stages(device, (40, 24), load_network(path, OPENCL))
    other = integer_model(tmp_path / "m.onnx", (20, 44, 12), 32)
    for each in (other, path):
        correction.use(load_network(each, OPENCL))
        frames, candidates = inputs(board)
        assert np.array_equal(
            judged(board, correction, step, frames, candidates), by_onnxruntime(each, frames, candidates)
        )
    correction.use(load_network(path))
    correction.upload("judgement", np.zeros_like(correction.read("judgement")))
    assert not judged(board, correction, step, frames, candidates).any() and not correction.runs_on_device


def test_weights_are_uploaded_once(device, default_model):
    network = load_network(cpu_model(default_model()), OPENCL)
    made = [stages(device, size, network)[0].stages["convolutions"] for size in ((40, 24), (64, 48))]
    shared = [name for name in made[0].buffer if name.startswith(("weights", "numbers"))]
    assert len(shared) > 20
    assert all(made[0].buffer[name] is made[1].buffer[name] for name in shared)


def moving_light(size, count=5):
    scene = Rects([Rect((0, 0, 8), frequency=0.5)])
    views = [camera(*size, (0.05 * k, 0, 0)) for k in range(count)]
    for k, view in enumerate(views):
        frame = scene.frame(view, k / 30, *size, (views[max(k - 1, 0)], 0), reset=k == 0)
        frame.color = frame.color * np.float16(0.7**k)
        yield frame


def test_pipelines_make_the_same_images(device, default_model, monkeypatch):
    """With kernels and with onnxruntime."""
    monkeypatch.setattr(inference, "default_model", default_model)
    images = {}
    for provider in (OPENCL, "cpu"):
        pipeline = Pipeline(device, 80, 48, Options(scn_provider=provider))
        images[provider] = []
        for frame in moving_light((80, 48)):
            pipeline.submit(frame)
            made = pipeline.extrapolate()
            images[provider].append((made.numpy("color").tobytes(), made.numpy("gae").tobytes()))
        timings = pipeline.take_timings()
        assert ("network" in timings, timings["convolutions"] > 0) == (provider != OPENCL, provider == OPENCL)
        assert pipeline.stages["correction"].unusable_pixels == 0
    assert images[OPENCL] == images["cpu"]
    assert any(final != gae for final, gae in images[OPENCL])


def test_kernels_run_it_on_a_gpu_by_default(device, default_model, monkeypatch):
    monkeypatch.setattr(inference, "default_model", default_model)
    for kind, provider in (("gpu", OPENCL), ("cpu", "CPUExecutionProvider")):
        monkeypatch.setattr(device, "info", replace(device.info, kind=kind))
        pipeline = Pipeline(device, 40, 24)
        made = pipeline.stages["correction"]
        assert made.network.provider == provider
        assert made.runs_on_device == (provider == OPENCL)


def test_the_host_waits_for_nothing(device, default_model, monkeypatch):
    """While the device has not begun with a frame, the next one is made: `extrapolate` returns."""
    monkeypatch.setattr(inference, "default_model", default_model)
    pipeline = Pipeline(device, 40, 24, Options(scn_provider=OPENCL, cut_detection=False))
    for frame in moving_light((40, 24), 4):
        made = made_before_the_device_begins(pipeline, frame)
    assert made.numpy("color").tobytes() != made.numpy("gae").tobytes()


def files_of(folder):
    return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


@pytest.mark.parametrize("scene", few(["gallery", "shadows", "courtyard"], "gallery"))
def test_runs_write_equal_files(device, gffe, default_model, monkeypatch, tmp_path, scene):
    """`gffe run` with kernels and with onnxruntime, in both forms of all other kernels."""
    monkeypatch.setattr(inference, "default_model", default_model)
    assert gffe("render", scene, tmp_path / "in", "--frames", 5, "--size", "96x64")[0] == 0
    made = {}
    for provider, lanes in ((OPENCL, 8), ("cpu", 8), (OPENCL, 1)):
        monkeypatch.setenv("GFFE_LANES", str(lanes))
        out, on = tmp_path / f"{provider}{lanes}", ("--device", device.info.index, "--scn-provider", provider)
        code, _, error = gffe("run", tmp_path / "in", out, *on, "--no-check")
        assert code == 0, error
        made[provider, lanes] = files_of(out)
    assert made[OPENCL, 8] == made["cpu", 8] == made[OPENCL, 1]
    assert sum(name.startswith("extrapolated") for name in made["cpu", 8]) == 5
