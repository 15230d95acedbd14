"""The shading correction network: encoding, warping, losses, crops, and training it on a small setting."""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gffe_cl.engine.core.errors import GffeError  # noqa: E402
from gffe_cl.engine.inference import network as inference  # noqa: E402
from gffe_cl.engine.stages.shading import TREND_PLANES, spacing_of  # noqa: E402
from gffe_cl.lab import metrics  # noqa: E402
from gffe_cl.lab.metrics import focus_mask, shading_regions  # noqa: E402
from gffe_cl.lab.training import data as data_module  # noqa: E402
from gffe_cl.lab.training import network  # noqa: E402
from gffe_cl.lab.training import training as trained  # noqa: E402
from gffe_cl.lab.training import training as training_module  # noqa: E402
from gffe_cl.lab.training.data import Augmentation, Batch, Crop, CropReader, focus_truth, list_crops, low_pass  # noqa: E402  # noqa: E402
from gffe_cl.lab.training.export import differences, export_onnx  # noqa: E402
from gffe_cl.lab.training.training import CHECKPOINT, Recipe, Training, split_crops, weights  # noqa: E402

read_batch = CropReader(torch.device("cpu")).batch


def random(*shape, seed=0, scale=1.0):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed)) * scale


# ---- network -------------------------------------------------------------------------------------------


def test_encoding():
    colors = torch.tensor([0.0, 1e-3, 0.1, 1.0, 8.0, 300.0, 60000.0])
    codes = network.encode(colors)
    assert codes[0] == 0 and codes[4] == pytest.approx(1.0)
    assert codes[3] == pytest.approx(math.log(1 + 5000 / 8) / math.log(5001))
    assert torch.allclose(network.decode(codes), colors, rtol=2e-4)
    assert network.encode(torch.tensor(-1.0)) == 0 and network.decode(torch.tensor(-0.5)) == 0


def test_composition():
    color = random(1, 3, 32, 48, scale=4.0)
    correction = torch.zeros(1, 5, 16, 24)
    correction[:, 3] = 1.0
    refined, final, mask = network.compose(color, correction)
    assert torch.equal(final, color) and not mask.any()
    assert torch.allclose(refined, color, rtol=1e-3, atol=1e-5)
    correction[:, 4] = 1 / 33  # under the threshold
    assert torch.equal(network.compose(color, correction)[1], color)
    correction[:, 4, :, :12], correction[:, :3] = 1.0, 0.1
    _, final, mask = network.compose(color, correction)
    ratio = (final / color).mean(1)
    assert (ratio[..., :20] > 1.3).all() and torch.equal(final[..., 28:], color[..., 28:])
    correction[:, 3] = 0.0  # without detail, neighbors are equal but for what is between them at half resolution
    plain = network.compose(color, correction)[0]
    assert plain[..., :20].std() < 0.8 * final[..., :20].std()


def test_training_begins_with_another_network_s_weights():
    """Also with those of one that has fewer inputs; what it does not have counts for nothing."""
    torch.manual_seed(1)
    one, other = network.ShadingCorrectionNetwork().eval(), network.ShadingCorrectionNetwork().eval()
    weights = {name: value.detach().numpy() for name, value in one.convolutions.named_parameters()}
    head = one.head_weights()
    inputs = random(1, 8, 32, 32), torch.tensor([0.5]), random(1, TREND_PLANES, 16, 16)
    other.take(weights, head)
    with torch.no_grad():
        assert torch.equal(one(*inputs), other(*inputs))
        first = "seen.0.weight"
        other.take(weights | {first: weights[first][:, :6]}, head)
        one.convolutions.get_parameter(first)[:, 6:] = 0
        assert torch.allclose(one(*inputs), other(*inputs), atol=1e-6)
    with pytest.raises(ValueError, match=r"'out\.bias' is missing"):
        other.take({name: value for name, value in weights.items() if name != "out.bias"}, head)
    with pytest.raises(ValueError, match=r"'out.weight' is \[99, 24, 3, 3\]"):
        other.take(weights | {"out.weight": np.zeros((99, 24, 3, 3), np.float32)}, head)
    with pytest.raises(ValueError, match="its head has 3 weights"):
        other.take(weights, head[:3])


# ---- losses --------------------------------------------------------------------------------------------


def test_structural_similarity_is_the_metric():
    a, b = random(2, 3, 40, 32).abs().clamp(max=1), random(2, 3, 40, 32, seed=1).abs().clamp(max=1)
    measured = [metrics.ssim(x, y) for x, y in zip(*(t.permute(0, 2, 3, 1).numpy() for t in (a, b)), strict=True)]
    assert trained.ssim(a, b).item() == pytest.approx(np.mean(measured), abs=1e-5)


def test_vgg(tmp_path):
    torch.manual_seed(0)
    layout = {0: (3, 64), 2: (64, 64), 5: (64, 128), 7: (128, 128), 10: (128, 256), 12: (256, 256), 14: (256, 256)}
    layout |= {16: (256, 256), 19: (256, 512), 21: (512, 512)}
    state = {f"features.{k}.weight": 0.05 * torch.randn(o, i, 3, 3) for k, (i, o) in layout.items()}
    state |= {f"features.{k}.bias": torch.zeros(o) for k, (_, o) in layout.items()}
    state["classifier.0.weight"] = torch.zeros(1)
    torch.save(state, tmp_path / "vgg19-abc.pth")
    loss = trained.perceptual_loss(tmp_path / "vgg19-abc.pth")
    a, b = random(1, 3, 32, 32), random(1, 3, 32, 32, seed=1).requires_grad_()
    assert loss.name == "VGG-19" and loss(a, a) == 0
    loss(b, a).backward()
    assert b.grad.abs().sum() > 0
    (tmp_path / "bad.pth").write_bytes(b"nothing")
    with pytest.raises(GffeError, match=r"bad\.pth: not VGG-19"):
        trained.perceptual_loss(tmp_path / "bad.pth")


# ---- data ----------------------------------------------------------------------------------------------


def test_crops_are_ranked_by_areas_not_outlines():
    rng = np.random.default_rng(0)
    sample = np.full((data_module.CHANNELS, 270, 480), 0.5, np.float16)
    sample[data_module.PLANES["truth"], :, ::4] = 0.05  # a fence that is wrong everywhere
    assert all(focus == 0 for _, _, focus in data_module.crops_of(sample, rng))
    sample[data_module.PLANES["truth"], 100:140, 200:260] = 0.05  # a shadow
    found = data_module.crops_of(sample, rng)
    assert max(focus for *_, focus in found) == pytest.approx(38 * 58 / 256**2, rel=0.2)


def test_focus_masks_agree():
    rng = np.random.default_rng(0)
    truth = rng.uniform(0, 1, (40, 50, 3)).astype(np.float32)
    gae = truth * rng.uniform(0.2, 1.2, (40, 50, 1)).astype(np.float32)
    dynamic = rng.random((40, 50)) < 0.2
    expected = focus_mask(gae, truth, dynamic)
    planes = [torch.from_numpy(x.transpose(2, 0, 1)[None]) for x in (gae, truth)]
    mask = focus_truth(*planes, torch.from_numpy(dynamic[None, None]))
    assert 0.01 < expected.mean() < 0.6 and not expected[dynamic].any()
    assert (mask[0, 0].numpy() == expected).all()


def test_training_is_validated_where_evaluation_measures():
    """Disoccluded pixels are no focus pixels, whatever is wrong there."""
    batch = batch_of(size=32)
    batch.side[:, 1, 8:16] = 0.0
    batch.side[:, 1, :, :8] = 1.0  # the input mask of a dynamic pixel, disoccluded or not
    regions = batch.regions()
    for k in range(3):
        gae, truth = (image[k].numpy().transpose(1, 2, 0) for image in (batch.gae, batch.truth))
        mask = batch.side[k, 1].numpy()
        expected = shading_regions(focus_mask(gae, truth, mask == 1), mask == 0)
        for name, wanted in expected.items():
            assert (regions[name][k, 0].numpy() == wanted).all(), name
    assert regions["focus"].any() and (batch.focus() & regions["disoccluded"]).any()
    assert not (regions["focus"] & regions["disoccluded"]).any()


def batch_of(count=3, size=64, alpha=0.5):
    colors = [random(count, 3, size, size, seed=k) for k in range(3)]
    side = torch.full((count, 2, size, size), 0.5)
    side[:, 1, :, : size // 4] = 1.0  # dynamic
    trends = random(count, TREND_PLANES, size // 4, size // 4, seed=4, scale=0.02) - 0.01
    return Batch(*colors, side, trends, torch.full((count,), alpha), torch.full((count,), 270.0))


def halved(batch):
    """As `CropReader` reads it at half resolution."""
    samples = data_module.halve_samples(torch.cat(batch.images(), 1).numpy().astype(np.float16))
    planes = torch.from_numpy(samples.astype(np.float32))
    images = (planes[:, part] for part in data_module.PLANES.values())
    return Batch(*images, batch.trends.clone(), batch.alpha, batch.heights, True)


def test_augmentation_follows_its_generator():
    made = [Augmentation(torch.Generator().manual_seed(s))(batch_of()) for s in (1, 1, 2)]
    assert torch.equal(made[0].truth, made[1].truth) and torch.equal(made[0].gae, made[1].gae)
    assert torch.equal(made[0].trends, made[1].trends) and made[0].trends.shape == (3, TREND_PLANES, 16, 16)
    assert not torch.equal(made[0].truth, made[2].truth)
    small = Augmentation(torch.Generator().manual_seed(1))(halved(batch_of()))
    assert small.halved and small.gae.shape[-1] == 32
    for batch in (*made, small):
        assert all(torch.isfinite(x).all() and (x >= 0).all() for x in (batch.gae, batch.previous, batch.truth))


def test_trends_are_what_the_stage_finds():
    """The augmentation's blur against the twin of the kernel's, over cells of which some are not known."""
    import twins

    height, cells = 540, 24
    known = (random(1, 1, cells, cells, seed=2) < 0.7).float()
    changes = (random(1, 3, cells, cells) - 0.5) * known
    expected = twins.find_trend(torch.cat((changes, known), 1)[0].numpy(), spacing_of(height))[:3]
    spread = [torch.repeat_interleave(torch.repeat_interleave(x, 4, -1), 4, -2) for x in (changes, known)]
    found = low_pass(*spread, torch.tensor([float(height)]))
    expected = np.stack([twins.doubled(plane) for plane in expected])
    np.testing.assert_allclose(found[0].numpy(), expected, atol=1e-6)


# ---- training ------------------------------------------------------------------------------------------

RECIPE = Recipe(seed=3, steps=16, batch=4, learning_rate=3e-3, final_learning_rate=1e-3, full_every=8)
CLIPS = 2


@pytest.fixture(scope="module", autouse=True)
def small():
    """Clips hardly larger than a crop, and a few crops to validate with."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(data_module, "_SIZES", ((288, 264),) * len(data_module._SIZES))
        patch.setattr(data_module, "_SAMPLES", 2)
        patch.setattr(training_module, "_VALIDATION_CROPS", 4)
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory, opened, small):
    """Small clips, and their folder."""
    folder = tmp_path_factory.mktemp("training")
    assert data_module.make_clips(folder, opened, 3, CLIPS) == CLIPS
    return folder


@pytest.fixture(scope="module")
def opened():
    from gffe_cl.engine.opencl.device import open_device

    return open_device()


def started(folder, data, recipe=RECIPE):
    return Training(folder, recipe, list_crops(data, 3, CLIPS), clips=CLIPS)


@pytest.mark.long
@pytest.mark.slow
def test_clips_are_cached_and_resumable(data, opened):
    assert data_module.make_clips(data, opened, 3, CLIPS) == 0
    path = data_module.clip_path(data, 3, 1)
    document, samples = json.loads(path.with_suffix(".json").read_text()), np.load(path)
    path.with_suffix(".json").unlink()  # as if it had been interrupted there
    assert data_module.make_clips(data, opened, 3, CLIPS) == 1
    assert json.loads(path.with_suffix(".json").read_text()) == document
    assert (np.load(path) == samples).all()
    plan = document["plan"]
    assert samples.shape == (4, data_module.CHANNELS, plan["height"], plan["width"]) and len(document["alphas"]) == 4
    half = np.load(data_module.halved_path(path))
    assert half.shape == (4, data_module.HALVED_CHANNELS, plan["height"] // 2, plan["width"] // 2)
    for trend in half[:, data_module.CHANNELS :].astype(np.float32):
        assert trend[:3].any() and trend[3:6].any() and 0 < trend[6].mean() <= 1
    gae, truth = samples[:, data_module.PLANES["gae"]], samples[:, data_module.PLANES["truth"]]
    assert np.abs(gae.astype(np.float32) - truth).mean() < 0.1 * truth.astype(np.float32).mean()


@pytest.mark.slow
def test_clips_are_made_without_the_network(data, opened, tmp_path, monkeypatch):
    """Whatever weights are installed: they are to correct the extrapolated frame, not one that is corrected."""
    from scn_models import constant_model

    model = Path(constant_model(tmp_path / "m.onnx", delta=0.3, mask=1.0))
    monkeypatch.setattr(inference, "default_model", lambda: model)
    samples, *_ = data_module.make_clip(opened, data_module.ClipPlan.draw(3, 1))
    assert (samples == np.load(data_module.clip_path(data, 3, 1))).all()


@pytest.mark.slow
def test_crops_at_half_resolution_are_what_the_network_sees(data):
    crops = [crop for crop in list_crops(data, 3, CLIPS) if crop.x % 2 == crop.y % 2 == 0][:2]
    whole, half = read_batch(crops), read_batch(crops, halved=True)
    assert half.halved and half.gae.shape == (2, 3, data_module.CROP // 2, data_module.CROP // 2)
    assert torch.allclose(half.frames(), whole.frames(), atol=2e-3)
    assert torch.equal(half.trends, whole.trends)
    assert half.trends.shape == (2, TREND_PLANES, data_module.CROP // 4, data_module.CROP // 4)
    assert half.heights.tolist() == [264, 264]


@pytest.mark.slow
@pytest.mark.long
def test_training_improves_the_loss_and_reaches_every_weight(data, tmp_path):
    training = started(tmp_path / "run", data)
    crops = training.crops[:8]
    before = fixed_loss(training, crops)
    start = {name: value.clone() for name, value in training.network.named_parameters()}
    assert training.run()
    after = fixed_loss(training, crops)
    assert after["loss"] < 0.96 * before["loss"]
    assert after["focus"] < before["focus"]
    for name, value in training.network.named_parameters():
        assert value.grad is not None and value.grad.abs().sum() > 0, name
        assert not torch.equal(value, start[name]), name
    out = training.network.head[1].weight.grad.abs().sum((1, 2, 3))
    assert (out > 0).all(), "Δ, keep or M"
    first = training.network.convolutions.seen[0].weight.grad.abs().sum((0, 2, 3))
    assert (first > 0).all(), "of the frames"
    figures = training.validate()
    assert all(math.isfinite(value) for value in figures.values())


@pytest.mark.long
def test_in_integers_a_network_is_taught_by_that_in_floats(data, tmp_path):
    """By what it was begun with, which stays; and only then."""
    assert started(tmp_path / "floats", data, Recipe(seed=3, steps=1, batch=2)).teacher is None
    training = started(tmp_path / "run", data, Recipe(seed=3, steps=3, batch=2, integers=True))
    teacher, batch = training.teacher, read_batch(training.crops[:2], halved=True)
    said = [p.clone() for p in teacher.parameters()]
    inputs = batch.frames(), batch.alpha, batch.trends
    terms = []
    for student in (teacher, training.network.eval()):
        correction = student(*inputs)
        rest = correction[:, 4:5], batch, batch.focus().float(), training.perceptual, teacher(*inputs)
        terms.append(float(training_module.loss_terms(correction, *rest)["teacher"].detach()))
    assert terms[0] < 1e-9 < terms[1]
    taught = training._train_step()
    assert taught["teacher"] > 0 and taught["loss"] > 4 * taught["teacher"]
    assert all(torch.equal(p, was) for p, was in zip(teacher.parameters(), said, strict=True))
    assert not any(p.requires_grad for p in teacher.parameters())


def fixed_loss(training, crops):
    from gffe_cl.lab.training.training import loss_terms

    batch = read_batch(crops)
    with torch.no_grad():
        out = training.network.train()(batch.frames(), batch.alpha, batch.trends)
        terms = loss_terms(*out, batch, batch.focus().float(), training.perceptual)
    factors = weights(training.recipe)
    return terms | {"loss": sum(factors[name] * value for name, value in terms.items())}


@pytest.mark.long
def test_equal_seeds_agree_and_slices_make_no_difference(data, tmp_path):
    recipe = Recipe(seed=3, steps=4, batch=1)
    whole = started(tmp_path / "whole", data, recipe)
    assert whole.run()
    part = started(tmp_path / "parts", data, recipe)
    assert not part.run(until=0.0) and part.step == 1  # whatever the time
    for _ in range(2):
        part = started(tmp_path / "parts", data, recipe)
        stop = part.step + 1
        with pytest.raises(KeyboardInterrupt):
            part.run(on_step=lambda made, stop=stop: interrupt(made == stop))
    part = started(tmp_path / "parts", data, recipe)
    assert part.step == 3 and part.run()
    assert_same_weights(whole, part)
    other = started(tmp_path / "other", data, Recipe(seed=4, steps=4, batch=1))
    assert other.run()
    assert not torch.allclose(next(other.network.parameters()), next(whole.network.parameters()), atol=1e-4)


@pytest.mark.long
@pytest.mark.slow
def test_two_processes_train_as_one_does(data, tmp_path):
    """They end within the spread of seeds; one writes; and they go on where they were stopped."""

    def train(name, *words):
        parallel = ("-m", "torch.distributed.run", "--nproc-per-node", "2", "-m", "gffe_cl", "train", tmp_path / name)
        options = ("--data", data, "--clips", CLIPS, "--seed", 3, "--steps", 8, "--batch", 2, "--full-every", 8)
        rates = ("--learning-rate", 3e-3, "--final-learning-rate", 1e-3)
        command = [sys.executable, *map(str, (*parallel, *options, *rates, *words))]
        done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
        assert done.returncode == 0 and done.stdout.count("final error:") == 1, done.stderr
        assert {path.name for path in (tmp_path / name).iterdir()} == {CHECKPOINT, "scn.onnx"}
        return started(tmp_path / name, data, recipe)

    recipe = replace(RECIPE, steps=8, batch=2)
    stopped = train("parts", "--minutes", 1e-4)
    assert 0 < stopped.step < 8
    together, parts = train("whole"), train("parts")
    assert together.step == parts.step == 8
    assert_same_weights(together, parts)
    alone = [started(tmp_path / f"alone{seed}", data, replace(recipe, seed=seed)) for seed in (3, 4, 5)]
    crops = alone[0].crops[:8]
    before = fixed_loss(alone[0], crops)["loss"]
    assert all(training.run() for training in alone)
    losses = [float(fixed_loss(training, crops)["loss"]) for training in alone]
    spread = max(losses) - min(losses)
    assert abs(fixed_loss(together, crops)["loss"] - losses[0]) < spread < before - max(losses)


def assert_same_weights(one, other):
    for a, b in zip(one.network.parameters(), other.network.parameters(), strict=True):
        assert torch.allclose(a, b, atol=1e-6)


def interrupt(now):
    if now:
        raise KeyboardInterrupt


@pytest.mark.long
@pytest.mark.slow
def test_checkpoints_of_other_runs_are_refused(data, tmp_path, monkeypatch):
    training = started(tmp_path, data, Recipe(seed=3, steps=2, batch=2))
    training.save()
    with pytest.raises(GffeError, match=r"was started with steps 2 \(expected the same options"):
        started(tmp_path, data, Recipe(seed=3, steps=9, batch=2))
    with monkeypatch.context() as patch:
        patch.setattr(trained, "LOSSES_VERSION", trained.LOSSES_VERSION + 1)
        with pytest.raises(GffeError, match=rf"was started with losses {trained.LOSSES_VERSION - 1} \(expected"):
            started(tmp_path, data, Recipe(seed=3, steps=2, batch=2))
    (tmp_path / CHECKPOINT).write_bytes(b"broken")
    with pytest.raises(GffeError, match=r"checkpoint\.pt: not a checkpoint"):
        started(tmp_path, data)


@pytest.mark.slow
def test_broken_data_is_named(data, tmp_path):
    with pytest.raises(GffeError, match="no training clips"):
        list_crops(tmp_path, 3, 5)
    path = data_module.clip_path(tmp_path, 3, 0)
    source = data_module.clip_path(data, 3, 0)
    path.with_suffix(".json").write_text(source.with_suffix(".json").read_text())
    for cut in (path, data_module.halved_path(path)):
        for file, whole in ((path, source), (data_module.halved_path(path), data_module.halved_path(source))):
            file.write_bytes(whole.read_bytes()[: 1000 if file == cut else None])
        with pytest.raises(GffeError, match=rf"{cut.name}: not a training clip"):
            read_batch(list_crops(tmp_path, 3, 1)[:1])
    path.with_suffix(".json").write_text("{")
    with pytest.raises(GffeError, match=r"clip_3_000000\.json: not a description"):
        list_crops(tmp_path, 3, 1)


@pytest.mark.long
@pytest.mark.slow
def test_a_loss_that_is_not_finite_keeps_the_checkpoint(data, tmp_path):
    recipe = Recipe(seed=3, steps=4, batch=1)
    training = started(tmp_path, data, recipe)
    with pytest.raises(KeyboardInterrupt):
        training.run(on_step=lambda made: interrupt(made == 2))
    training = started(tmp_path, data, recipe)
    with torch.no_grad():
        training.network.head[1].bias.fill_(math.nan)
    with pytest.raises(GffeError, match="the loss is not finite at step 2"):
        training.run()
    kept = started(tmp_path, data, recipe)
    assert kept.step == 2 and all(torch.isfinite(value).all() for value in kept.network.parameters())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--minutes", "0"], "--minutes must be positive"),
        (["--clips", "1"], "--clips must be at least 2"),
        (["--learning-rate", "1e-7"], "learning rates must be"),
    ],
)
def test_wrong_options_are_one_line(arguments, message, tmp_path, gffe):
    code, _, told = gffe("train", tmp_path / "run", *arguments)
    assert code == 2 and message in told and len(told.splitlines()) == 1 and not list(tmp_path.iterdir())


@pytest.mark.long
def test_however_short_the_time_there_is_a_model_in_the_end(gffe, tmp_path):
    """Clips take all of it, and yet some steps are done; the same command goes on with the clips it began with."""

    def train():
        words = ("--seed", 3, "--batch", 1, "--steps", 1000, "--minutes", 0.002, "--json", tmp_path / "report.json")
        code, text, told = gffe("train", tmp_path / "run", *words)
        return code, text + told, json.loads((tmp_path / "report.json").read_text())

    code, _, report = train()
    assert code == 0 and not report["done"] and report["step"] > 0
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {"scn.onnx", CHECKPOINT}
    assert len(data_module.finished_clips(tmp_path / "run" / "data", 3, 400)) == 2
    inference.load_network(tmp_path / "run" / "scn.onnx")
    _, told, later = train()
    assert later["step"] > report["step"] and later["data"].startswith("2 clips")
    assert "going on with the 2 clips that this run was started with" in told


def test_validation_clips_are_not_trained_on():
    crops = [Crop(f"clip{k}", 0, 0, x, 0.5, 0.1) for k in range(10) for x in range(5)]
    held, rest = split_crops(crops, 0)
    assert held and {crop.path for crop in held}.isdisjoint(crop.path for crop in rest)


def test_export(tmp_path):
    torch.manual_seed(0)
    net = network.ShadingCorrectionNetwork()
    assert export_onnx(net, tmp_path / "scn.onnx") < 2e-4
    other = network.ShadingCorrectionNetwork()
    assert differences(other.eval(), tmp_path / "scn.onnx")[0] > 1e-3
    assert [path.name for path in tmp_path.iterdir()] == ["scn.onnx"]
    with pytest.raises(GffeError, match="cannot write the model"):
        export_onnx(net, tmp_path / "no" / "scn.onnx")


def test_the_pipeline_makes_what_the_trained_network_does(opened, tmp_path):
    """Flow search, convolutions and head in kernels and onnxruntime, against PyTorch's forward."""
    from gffe_cl import Options, Pipeline
    from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene

    torch.manual_seed(5)
    net, model = network.ShadingCorrectionNetwork(), tmp_path / "scn.onnx"
    net.convolutions.out.weight.data *= 5
    export_onnx(net, model)
    frames = SceneFrames(SceneRenderer(opened, load_scene("corridor", 0), 96, 64))
    pipeline = Pipeline(opened, 96, 64, Options(scn_model=str(model)))
    pipeline.keep()  # what the focus mask leaves out, too
    for frame in frames.sequence(3, 30, 0):
        pipeline.submit(frame)
    made = pipeline.extrapolate()
    assert np.isfinite(made.numpy("color")).all() and not pipeline.stages["correction"].unusable_pixels
    seen, trends = (
        torch.from_numpy(pipeline.stages[stage].read(name))[None]
        for stage, name in (("network_input", "frames"), ("shading_trend", "trends"))
    )
    with torch.no_grad():
        expected = net.eval()(seen, torch.tensor([made.alpha], dtype=torch.float32), trends)[0].numpy()
    assert trends.any() and np.abs(expected[:3]).max() > 0.01
    np.testing.assert_allclose(pipeline.stages["correction"].read("correction"), expected, atol=1e-4)
