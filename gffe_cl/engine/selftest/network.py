"""Comparison of the shading correction network in onnxruntime with the recorded output of the kernels."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.inference.network import Network, NetworkError, default_model, digest_of_weights, load_network
from gffe_cl.engine.selftest.reference import recorded


def model_digest() -> str:
    """Return the hash of the weights that come with the package, "" if there are none."""
    path = default_model()
    return "" if path is None else digest_of_weights(path)[:16]


def compare_network() -> float:
    """Return the largest difference of onnxruntime's output to the recorded one: 0 where the CPU has fused
    multiply-add, as x86-64 has since 2013. Raises NetworkError if it cannot run the network, or the weights are not the
    recorded ones."""
    reference = recorded()
    if reference.model != model_digest():
        raise NetworkError("the installed weights are not those that the references were recorded with")
    values, names = reference.values["default"], ("network_input.frames", "shading_flow.candidates")
    frames, candidates = (np.ascontiguousarray(values[name]) for name in names)
    expected = values["correction.judgement"]
    found, network = np.empty_like(expected), load_network()
    assert isinstance(network, Network)
    network.run(frames, candidates, found)
    return float(np.abs(np.where(np.isfinite(found), found, np.inf) - expected).max())
