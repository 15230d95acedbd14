"""The network in 8-bit integers: it says what it said in floats, but for rounding, and its file holds integers."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from onnx import numpy_helper  # noqa: E402

from gffe_cl.engine.inference import network as inference  # noqa: E402
from gffe_cl.engine.inference.network import cpu_model  # noqa: E402
from gffe_cl.lab.training.export import (  # noqa: E402
    differences,
    export_onnx,
    quantize,
)
from gffe_cl.lab.training.network import ShadingCorrectionNetwork  # noqa: E402


def inputs(count=6, seed=0):
    """Of the convolutions; channels of candidates differ by a factor of a thousand, as they do."""
    generator = torch.Generator().manual_seed(seed)
    sizes = torch.logspace(-2, 1, 16).view(1, 16, 1, 1)
    return [
        (torch.rand(1, 8, 32, 48, generator=generator), sizes * torch.randn(1, 16, 16, 24, generator=generator))
        for _ in range(count)
    ]


@pytest.fixture
def network():
    torch.manual_seed(0)
    made = ShadingCorrectionNetwork().eval()
    for name, parameter in made.named_parameters():
        if name.endswith("bias"):
            torch.nn.init.normal_(parameter, std=0.1)
    return made


def test_rounding_is_trained_through(network):
    """Gradients reach every weight as if there were no rounding."""
    quantize(network.convolutions, inputs())
    network.convolutions.train()(*inputs(1)[0]).square().mean().backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in network.convolutions.parameters())


def test_the_file_holds_integers(network, tmp_path):
    quantize(network.convolutions, inputs())
    assert export_onnx(network, tmp_path / "scn-int8.onnx", integers=True) < 0.05
    model = onnx.load(str(tmp_path / "scn-int8.onnx"))
    tensors = {tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    weights = [array for array in tensors.values() if array.dtype == np.int8 and array.ndim == 4]
    assert len(weights) == 13 and all(abs(array.astype(int)).max() == 63 for array in weights)
    floats = {
        name for name, array in tensors.items() if array.dtype == np.float32 and array.ndim == 4 and array.size > 16
    }
    assert floats == {"seen.0.weight", "out.weight"}
    loaded = inference.Network(tmp_path / "scn-int8.onnx")
    assert np.array_equal(loaded.head, network.head_weights())
    kernels = inference.KernelNetwork(tmp_path / "scn-int8.onnx")  # the layers lie beside it
    assert len(kernels.layers.layers) == 19 and np.array_equal(kernels.head, loaded.head)
    torch.manual_seed(1)
    assert differences(ShadingCorrectionNetwork().eval(), tmp_path / "scn-int8.onnx")[1] > 0.2


@pytest.fixture
def both(monkeypatch, default_model):
    """The package's network as CPUs run it, in integers, and its file named by somebody, which runs as it is."""
    monkeypatch.setattr(inference, "default_model", default_model)
    return inference.load_network(), inference.load_network(default_model())


def test_cpus_run_the_packages_network_in_integers(both):
    packaged, named = both
    kinds = [{node.op_type for node in onnx.load(str(path)).graph.node} for path in (cpu_model(named.path), named.path)]
    assert "QuantizeLinear" in kinds[0] and "QuantizeLinear" not in kinds[1]
    rng = np.random.default_rng(0)
    frames = np.repeat(np.repeat(rng.uniform(0.3, 0.7, (8, 4, 6)), 8, 1), 8, 2).astype(np.float32)
    candidates = np.repeat(np.repeat(rng.normal(0, 0.05, (16, 4, 6)), 4, 1), 4, 2).astype(np.float32)
    candidates[[4, 14, 15]] = np.array((1, 1, 0.5), np.float32)[:, None, None]  # shares, and α
    said = []
    for each in (packaged, named):
        said.append(np.empty((20, 16, 24), np.float32))
        assert each.run(frames, candidates, said[-1]) == 0
    integers, floats = (each[3:] for each in said)  # before them: a flow that is 0, and a logit of large size
    assert 0.01 < np.sqrt(np.mean((integers - floats) ** 2) / np.mean(floats**2)) < 0.5


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_input_that_is_not_finite_stays_where_it_is(both, bad):
    """Integers know no NaN: what they make of it has limits, and pixels far from it are as they were."""
    said = []
    for value in (0.5, bad):
        frames, candidates = np.full((8, 32, 1024), 0.5, np.float32), np.zeros((16, 16, 512), np.float32)
        frames[:, 8, 8] = candidates[:, 4, 4] = value
        said.append(np.empty((20, 16, 512), np.float32))
        both[0].run(frames, candidates, said[-1])
    sound, hurt = said
    assert np.isfinite(hurt).all() and np.abs(hurt).max() < 1000
    assert np.array_equal(hurt[:, :, 256:], sound[:, :, 256:])
