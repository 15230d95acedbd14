"""The shading correction network in the pipeline, with small models in place of the trained one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest
from scn_models import CANDIDATES, FLOAT, FRAMES, constant_model, look_model, movers_model, pooling_model, save
from synthetic import Rect, Rects, camera
from twin_cases import run

from gffe_cl import GffeError, Options, Pipeline
from gffe_cl.engine.inference import network as inference
from gffe_cl.engine.inference.layers import HEAD_WEIGHTS, OUTPUT, shapes_at
from gffe_cl.engine.inference.network import load_network
from gffe_cl.engine.opencl.probing import quiet_builds


@pytest.fixture
def model(tmp_path):
    return lambda *args, **values: constant_model(tmp_path / "model.onnx", *args, **values)


def test_a_still_frame_needs_no_network(device, model):
    """It is the extrapolated one to the bit, and the network does not run. A light that changes for the first time is
    looked at, one that goes on is corrected."""
    scene, cam = Rects([Rect((0, 0, 8), frequency=0.5)]), camera(40, 24)
    pipeline = Pipeline(device, 40, 24, Options(scn_model=model(delta=0.2)))
    for k in range(4):
        frame = scene.frame(cam, k / 30, 40, 24, (cam, 0), reset=k == 0)
        frame.color = frame.color * np.float16((1, 1, 0.6, 0.36)[k])
        pipeline.submit(frame)
        made = pipeline.extrapolate()
        assert (bits(made.numpy("color")) == bits(made.numpy("gae"))) == (k < 3)
        assert (pipeline.take_timings()["network"] == 0) == (k < 2)
    assert not pipeline.stages["shading_trend"].is_still
    pipeline.submit(replace(frame, time=1.0))
    assert pipeline.stages["shading_trend"].is_still
    pipeline.submit(replace(frame, time=2.0, reset=True))
    assert not pipeline.stages["shading_trend"].is_still  # a reset forgets it


def test_separate_memories_give_the_same_bits(device, model, monkeypatch):
    """With one copy each way, of the last frame only; where memory is shared there is none."""
    path, host_memory, results = model(delta=0.1), cl.mem_flags.ALLOC_HOST_PTR, []
    names = "network_input.frames", "shading_flow.candidates", "correction.judgement"
    for shares in (True, False):
        monkeypatch.setitem(device.__dict__, "shares_memory", shares)
        case = run(device, 61, 37, Options(scn_model=path))
        pipeline, made = case.pipeline, case.made
        correction = pipeline.stages["correction"]
        stored = (pipeline.stages[stage].read(buffer) for stage, buffer in (name.split(".") for name in names))
        results.append([bits(made.numpy("color")), *map(bits, stored)])
        for name in names:
            assert bool(pipeline.board.buffer(*name.split(".")).flags & host_memory) == shares, name
        arrays = [view._staging for view in correction._views]
        assert all(array is None for array in arrays) == shares
        kinds = [event.command_type for event in correction._transfers]
        types = cl.command_type
        mapped = [types.MAP_BUFFER] * 3 + [types.UNMAP_MEM_OBJECT] * 3
        assert kinds == (mapped if shares else [types.READ_BUFFER] * 2 + [types.WRITE_BUFFER])
        assert pipeline.take_timings()["network copies"] > 0 and not correction._transfers
    assert results[0] == results[1]
    assert made.numpy("color").tobytes() != made.numpy("gae").tobytes()


def test_light_that_flickers_is_left_alone(device, model):
    scene, cam = Rects([Rect((0, 0, 8), frequency=0.5)]), camera(40, 24)
    pipeline = Pipeline(device, 40, 24, Options(scn_model=model(delta=0.2)))
    for k in range(6):
        frame = scene.frame(cam, k / 30, 40, 24, (cam, 0), reset=k == 0)
        frame.color = frame.color * np.float16(0.6 if k % 2 else 1)
        pipeline.submit(frame)
        made = pipeline.extrapolate()
        assert bits(made.numpy("color")) == bits(made.numpy("gae"))
    assert pipeline.take_timings()["network"] > 0


# ---- the pipeline --------------------------------------------------------------------------------------


def corrected(device, model, size=(61, 37), **options):
    case = run(device, *size, Options(scn_model=model, **options))
    return case.pipeline, case.made


def bits(array):
    return np.ascontiguousarray(array).tobytes()


@pytest.mark.parametrize("size", [(61, 37), (1, 24), (40, 1)])
def test_an_empty_mask_changes_no_bit(device, model, size):
    _, made = corrected(device, model(delta=0.3, mask=0.031), size)
    assert made.color is not made.gae and bits(made.numpy("color")) == bits(made.numpy("gae"))
    _, plain = corrected(device, None, size, shading_correction=False)
    assert plain.color is plain.gae and bits(made.numpy("gae")) == bits(plain.numpy("color"))
    for name in ("depth", "motion", "filled_by"):
        assert bits(made.numpy(name)) == bits(plain.numpy(name))


@pytest.mark.parametrize("size", [(61, 37), (1, 24)])
def test_no_change_leaves_the_picture(device, model, size):
    """Δ = 0 and all detail kept: the picture again, but for the encoding's rounding."""
    _, made = corrected(device, model(), size)
    gae = made.numpy("gae").astype(np.float64)
    shown = (gae >= 0).all(-1)
    np.testing.assert_allclose(made.numpy("color")[shown], gae[shown], rtol=2e-3, atol=2e-6)


def test_detail_that_is_not_kept_blurs_but_texture_stays(device, model):
    """Most detail of these frames is on the same surface in both."""
    _, made = corrected(device, model(keep=0.0))
    shown = (np.log1p(np.maximum(made.numpy(name), 0).astype(np.float64)) for name in ("gae", "color"))
    sharp, blurred = (np.abs(np.diff(image, axis=1)).mean() for image in shown)
    assert 0.9 * sharp < blurred < 0.99 * sharp


def test_a_change_counts_within_the_mask_only(device, tmp_path):
    """M = the input mask where movers are: they get brighter, nothing else does."""
    path = movers_model(tmp_path / "m.onnx", 0.05)
    pipeline, made = corrected(device, path)
    mask, gae, final = pipeline.stages["correction"].read("focus_mask"), made.numpy("gae"), made.numpy("color")
    assert 0.01 < (mask > 0).mean() < 0.9
    assert bits(final[mask == 0]) == bits(gae[mask == 0])
    inside = mask == 1
    assert inside.any() and (final[inside] > gae[inside]).mean() > 0.9
    _, whole = corrected(device, path, focus_mask=False)
    lit = (gae > 0).all(-1) & (gae < 3e4).all(-1)
    assert (whole.numpy("color")[lit] > gae[lit]).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("focus_mask", [True, False])
def test_bad_output_counts_as_no_mask(device, model, bad, focus_mask):
    judgements = [[0, 0, 0, 0, *[bad] * 16]]
    for judgement in judgements + [[0, 0, bad], [0, 0, 0, bad]] * bool(np.isnan(bad)):  # infinities have limits there
        _, made = corrected(device, model(judgement=judgement), focus_mask=focus_mask)
        assert bits(made.numpy("color")) == bits(made.numpy("gae")), judgement


def test_alpha_reaches_the_network(device, model):
    pipeline, made = corrected(device, model(mask="alpha"))
    assert made.alpha == pytest.approx(0.6)
    mask = pipeline.stages["correction"].read("focus_mask")
    assert (mask == np.float16(np.float32(made.alpha))).mean() > 0.5


def test_exposure_reaches_the_network(device, tmp_path):
    """Half the exposure on twice the color is the same to the network."""
    path, seen = look_model(tmp_path / "m.onnx"), []
    scene = Rects([Rect((0, 0, 8), frequency=0.5)])
    for scale in (1.0, 4.0):
        pipeline = Pipeline(device, 40, 24, Options(scn_model=path))
        pipeline.keep(["network_input.frames"])  # of a still frame, too
        pipeline.exposure = 1 / scale
        for k in range(2):
            frame = scene.frame(camera(40, 24), k / 30, 40, 24, (camera(40, 24), 0), reset=k == 0)
            frame.color = frame.color * np.float16(scale)
            pipeline.submit(frame)
        assert pipeline.extrapolate().color is not None
        seen.append(pipeline.stages["network_input"].read("frames"))
    np.testing.assert_allclose(seen[0], seen[1], rtol=1e-5)
    assert seen[0][:3].std() > 0.01


def test_after_a_reset_there_is_nothing_to_correct(device, model):
    scene, cam = Rects([Rect((0, 0, 8), frequency=0.5)]), camera(40, 24)
    pipeline = Pipeline(device, 40, 24, Options(scn_model=model(delta=0.2)))
    for k, reset in enumerate((True, False, False, True)):
        frame = scene.frame(cam, k / 30, 40, 24, (cam, 0), reset=reset)
        frame.color = frame.color * np.float16(1 - 0.2 * k)
        pipeline.submit(frame)
        made = pipeline.extrapolate()
        assert (bits(made.numpy("color")) == bits(made.numpy("gae"))) == (k != 2)  # k = 1 knows of one change only
        assert (pipeline.stages["correction"].read("focus_mask") == (k == 2)).all()
        assert (pipeline.take_timings()["network"] == 0) == reset


def test_off_by_choice_or_for_want_of_weights(device, model, monkeypatch):
    monkeypatch.setattr(inference, "default_model", lambda: None)
    assert "correction" not in Pipeline(device, 8, 8).stages and inference.scn_missing()
    with pytest.raises(GffeError, match=r"no trained weights .* expected gffe_cl/engine/inference/weights/scn.onnx"):
        Pipeline(device, 8, 8, Options(shading_correction=True))
    path = model()
    off = Options(shading_correction=False, scn_model=path)
    assert "correction" not in Pipeline(device, 8, 8, off).stages
    monkeypatch.setattr(inference, "default_model", lambda: Path(path))
    assert "correction" in Pipeline(device, 8, 8).stages and inference.scn_missing() is None


def test_five_runs_of_a_corrected_frame_give_the_same_bits(device, model):
    path, first = model(delta=0.1, mask=0.5), None
    for _ in range(5):
        pipeline, made = corrected(device, path)
        now = bits(made.numpy("color")), bits(pipeline.stages["network_input"].read("frames"))
        first = first or now
        assert now == first


# ---- onnxruntime ---------------------------------------------------------------------------------------

WRITES_ADDRESS = "__kernel void where(__global ulong *a) { a[0] = (ulong)a; }"


def test_nothing_is_copied_on_cpu_devices(device, model):
    """The memory that kernels write to is the memory that is mapped, and the memory that onnxruntime works in."""
    pipeline, _ = corrected(device, model(delta=0.1))
    stage, seen = pipeline.stages["correction"], []
    network = stage.network

    class Spy:
        def run(self, *arrays):
            seen.append([array.ctypes.data for array in arrays])
            return network.run(*arrays)

    stage.network = Spy()
    for _ in range(3):
        stage.infer()
    assert seen[0] == seen[1] == seen[2]
    if not device.cl_device.type & cl.device_type.CPU:
        pytest.skip("only CPU devices share memory with the host")
    with quiet_builds():
        where = cl.Program(device.context, WRITES_ADDRESS).build().where
    names = "network_input.frames", "shading_flow.candidates", "correction.judgement"
    for name, mapped in zip(names, seen[0], strict=True):
        where(device.queue, (1,), None, stage.board.buffer(*name.split(".")))
        address = np.empty(1, np.uint64)
        cl.enqueue_copy(device.queue, address, stage.board.buffer(*name.split(".")))
        assert address[0] == mapped, name


def test_onnxruntime_works_in_the_memory_it_is_given(tmp_path):
    """What is written to the bound input after binding is seen, and the output is where it was bound."""
    session = load_network(look_model(tmp_path / "m.onnx")).session
    arrays = {name: np.zeros(shape, np.float32) for name, shape in shapes_at(16, 16).items()}
    out = arrays.pop(OUTPUT)
    binding = session.io_binding()
    for name, array in arrays.items():
        binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
    binding.bind_output(OUTPUT, "cpu", 0, np.float32, out.shape, out.ctypes.data)
    arrays["frames"][:], arrays["candidates"][:] = 1, 3
    session.run_with_iobinding(binding)
    assert (out == 3).all() and binding.get_outputs()[0].data_ptr() == out.ctypes.data


def test_one_session_per_model_and_provider(model):
    path = model()
    first = load_network(path)
    assert load_network(path, "cpu") is first is load_network(str(path), "cpu")
    options = first.session.get_session_options()
    for kind in ("intra_op", "inter_op"):
        assert options.get_session_config_entry(f"session.{kind}.allow_spinning") == "0"
    model(delta=0.5)  # the file changes
    assert load_network(path) is not first


JUDGEMENT = (1, 20, "h", "w")


def _foreign(tmp_path, inputs, outputs=None, head=True):
    from onnx import helper

    outputs = outputs or ((OUTPUT, FLOAT, JUDGEMENT),)
    node = helper.make_node("Identity", [inputs[0][0]], [outputs[0][0]])
    return save(tmp_path / "foreign.onnx", [node], {}, inputs, outputs, np.zeros(HEAD_WEIGHTS * head, np.float32))


def test_models_that_are_none(tmp_path):
    """One line each: what, where, what was expected."""
    from onnx import TensorProto

    frames, candidates = ("frames", FLOAT, FRAMES), ("candidates", FLOAT, CANDIDATES)
    half = (("frames", TensorProto.FLOAT16, FRAMES), candidates), ((OUTPUT, TensorProto.FLOAT16, JUDGEMENT),)
    fixed, channels = (1, 8, 64, 64), (1, 3, "h", "w")
    of_old = (frames, ("alpha", FLOAT, (1,)), ("trends", FLOAT, (1, 7, "h", "w"))), (("correction", FLOAT, FRAMES),)
    cases = [
        (*of_old, "inputs alpha, frames, trends .expected candidates, frames"),
        ((("x", FLOAT, FRAMES), candidates), None, "inputs candidates, x .expected candidates, frames"),
        ((frames,), None, "inputs frames .expected candidates, frames"),
        ((frames, candidates), (("out", FLOAT, FRAMES),), "outputs out .expected judgement"),
        ((("frames", FLOAT, fixed), candidates), None, "frames is .* 1×8×64×64 .*1×8×any×any"),
        ((("frames", FLOAT, channels), candidates), None, "frames is .* 1×3×h×w"),
        ((frames, ("candidates", FLOAT, ())), None, "input candidates is"),
        (*half, r"frames is tensor.float16. 1×8×height×width .expected tensor.float. 1×8×any×any"),
        (
            (frames, candidates),
            ((OUTPUT, FLOAT, FRAMES),),
            "output judgement is .* 1×8×height×width .expected .* 1×20×any×any",
        ),
    ]
    for inputs, outputs, expected in cases:
        with pytest.raises(GffeError, match=rf"foreign.onnx: no shading correction network: .*{expected}") as caught:
            load_network(_foreign(tmp_path, inputs, outputs))
        assert "\n" not in str(caught.value)
    with pytest.raises(GffeError, match=r"metadata 'head' has 0 numbers .expected 374"):
        load_network(_foreign(tmp_path, (frames, candidates), head=False))
    for content in (b"", b"no model at all", b"\x00" * 4000):
        (tmp_path / "junk.onnx").write_bytes(content)
        with pytest.raises(GffeError, match=r"junk.onnx: .*expected an? .*ONNX") as caught:
            load_network(tmp_path / "junk.onnx")
        assert "\n" not in str(caught.value)
    for path in (tmp_path / "none.onnx", tmp_path):
        with pytest.raises(GffeError, match="no such file"):
            load_network(path)


def test_a_model_that_fails_says_so(device, tmp_path):
    """A model that gives another size than asked for."""
    path = pooling_model(tmp_path / "m.onnx")
    with pytest.raises(GffeError, match=r"m.onnx: the network failed on CPUExecutionProvider") as caught:
        corrected(device, path)
    assert "\n" not in str(caught.value)
