"""Comparison of the shading correction network on a provider of onnxruntime with recorded output: in 8-bit integers, as
the CPU runs it, with that of the kernels, bit by bit; in floats, as others run it, with the CPU's."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.inference.model_interface import JUDGEMENT_PLANES
from gffe_cl.engine.inference.network import Network, NetworkError, default_model, digest_of_weights, load_network
from gffe_cl.engine.inference.provider_check import verdict
from gffe_cl.engine.inference.providers import CPU, installed_providers
from gffe_cl.engine.selftest.reference import Reference, recorded

_STEP = 2.0**-13  # recorded values are multiples of it


def providers() -> list[str]:
    """Return the names of the installed providers that have a device here."""
    model = default_model()
    return [p.name for p in installed_providers() if p == CPU or (model and verdict(model, p).present)]


def output_of(provider: str, reference: Reference, in_floats: bool = False) -> np.ndarray:
    """Return (20, h, w) float32: the network's output for the recorded input; `in_floats`: in floats on the CPU, too.
    Raises NetworkError."""
    values, names = reference.values["default"], ("network_input.frames", "shading_flow.candidates")
    frames, candidates = (np.ascontiguousarray(values[name]) for name in names)
    made = np.empty((JUDGEMENT_PLANES, *candidates.shape[1:]), np.float32)
    network = load_network(default_model() if in_floats else None, provider)
    assert isinstance(network, Network)
    network.run(frames, candidates, made)
    return made


def model_digest() -> str:
    """Return the hash of the weights that come with the package, "" if there are none."""
    path = default_model()
    return "" if path is None else digest_of_weights(path)[:16]


def record(reference: Reference) -> None:
    """Write the CPU provider's output in floats into `reference`."""
    reference.model = model_digest()
    output = output_of(CPU.name, reference, in_floats=True)
    reference.network = np.round(output / _STEP) * np.float32(_STEP)


def compare_provider(provider: str) -> float:
    """Return the largest difference to the recorded output. If it is over TOLERANCE, the provider is not to be trusted.
    The CPU's is 0 where it has fused multiply-add, as x86-64 has since 2013. Raises NetworkError if the provider cannot
    run the network, or the weights are not the recorded ones."""
    reference = recorded()
    if reference.model != model_digest():
        raise NetworkError("the installed weights are not those that the references were recorded with")
    assert reference.network is not None
    by_kernels = reference.values["default"]["correction.judgement"]
    found, expected = output_of(provider, reference), by_kernels if provider == CPU.name else reference.network
    return float(np.abs(np.where(np.isfinite(found), found, np.inf) - expected).max())
