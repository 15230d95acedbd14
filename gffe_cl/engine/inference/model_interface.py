"""Interface of the shading correction network's ONNX model: names and shapes of inputs and output, and metadata."""

from __future__ import annotations

import base64

import numpy as np

MULTIPLE = 16  # of the width and height of its frames
INPUT_PLANES, CANDIDATE_PLANES, JUDGEMENT_PLANES = 8, 16, 20
HEAD = "head"  # key of the metadata
HEAD_LAYERS = ((16, 16), (6, 16))  # outputs and inputs of each
HEAD_WEIGHTS = sum(outputs * (inputs + 1) for outputs, inputs in HEAD_LAYERS)
INPUTS, OUTPUT = ("frames", "candidates"), "judgement"


def shapes_at(height: int, width: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of inputs and output by name, for frames of this size."""
    quarter = height // 2, width // 2
    return {
        "frames": (1, INPUT_PLANES, height, width),
        "candidates": (1, CANDIDATE_PLANES, *quarter),
        "judgement": (1, JUDGEMENT_PLANES, *quarter),
    }


def head_text(weights: np.ndarray) -> str:
    """Return the metadata for a head of these weights: of each layer rows, then biases."""
    return base64.b64encode(weights.astype("<f4").tobytes()).decode()


def head_weights(text: str) -> np.ndarray:
    """Return the head's weights (n,) float32: the inverse of `head_text`. The array is empty for a text that holds
    none."""
    try:
        return np.frombuffer(base64.b64decode(text, validate=True), "<f4").astype(np.float32)
    except ValueError:
        return np.empty(0, np.float32)
