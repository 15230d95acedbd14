"""Losses of the shading correction network (paper: appendix, 'Loss Functions'); all in the encoded space."""

from __future__ import annotations

import pickle
from pathlib import Path

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.transfer_function import SRGB_TOE
from gffe_cl.lab.training.network import encode

VERSION = 5  # of the terms' definition: a run continues only with its own
FOCUS_WEIGHT = 0.05  # λ_focus; the paper's is 1, and its mask covers large errors only
PERCEPTUAL_WEIGHT = 0.01  # λ_vgg of the paper
TEACHER_WEIGHT = 16.0  # of the frame of the network in floats, for one in integers
TAUGHT = 0.2  # how much the refined image is taught where the focus mask is 0
_CHARBONNIER = 1e-3
_DISPLAY_WEIGHT = 10.0
_STRUCTURE_WEIGHT = 0.05
_WINDOW = 7  # pixels: that of `gffe_cl.lab.metrics.ssim`
_TOE = float(SRGB_TOE)
# Errors of `torch.load`, and of content that is not as expected.
UNREADABLE = (
    OSError,
    EOFError,
    RuntimeError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ImportError,
    pickle.UnpicklingError,
)


def charbonnier(a: Tensor, b: Tensor) -> Tensor:
    """Return the mean of √((a − b)² + ε²) − ε."""
    return (torch.sqrt((a - b) ** 2 + _CHARBONNIER**2) - _CHARBONNIER).mean()


def shown_loss(a: Tensor, b: Tensor) -> Tensor:
    """Return the loss of exposed linear frames as they are displayed.

    The terms are Charbonnier of encoded color; the squared error of display values (sRGB), which PSNR counts; and 1 −
    SSIM of them, which penalizes texture that is carried along with moving light.
    """
    shown, truth = display(a), display(b)
    squared = ((shown - truth) ** 2).mean()
    return charbonnier(encode(a), encode(b)) + _DISPLAY_WEIGHT * squared + _STRUCTURE_WEIGHT * (1 - ssim(shown, truth))


def ssim(a: Tensor, b: Tensor) -> Tensor:
    """Return the mean structural similarity of display values (N, 3, H, W), as `gffe_cl.lab.metrics.ssim` does."""

    def mean(x: Tensor) -> Tensor:
        return functional.avg_pool2d(x, _WINDOW, stride=1)

    unbiased = _WINDOW**2 / (_WINDOW**2 - 1)
    mean_a, mean_b = mean(a), mean(b)
    variance_a, variance_b = unbiased * (mean(a * a) - mean_a**2), unbiased * (mean(b * b) - mean_b**2)
    covariance = unbiased * (mean(a * b) - mean_a * mean_b)
    brightness = (2 * mean_a * mean_b + 0.01**2) / (mean_a**2 + mean_b**2 + 0.01**2)
    return (brightness * (2 * covariance + 0.03**2) / (variance_a + variance_b + 0.03**2)).mean()


def display(color: Tensor) -> Tensor:
    """Return sRGB of exposed linear color, clipped to 0 … 1, as `gffe_cl.lab.metrics.to_display` does."""
    linear = color.clamp(0, 1)
    curve = 1.055 * linear.clamp(min=_TOE) ** (1 / 2.4) - 0.055
    return torch.where(linear <= _TOE, 12.92 * linear, curve)


def focus_loss(likely: Tensor, truth: Tensor) -> Tensor:
    """Return the mean squared error of the focus mask. The paper writes ‖M̄ − M‖₂; the difference is on purpose.

    With a root, per crop or batch, crops with larger errors would count less, and the mask would be too small where it
    is needed. A sum would grow with the crop and outweigh all other terms.
    """
    return ((likely - truth) ** 2).mean()


class PyramidLoss(nn.Module):
    """Replaces the perceptual loss where VGG's weights are not on disk: mean |difference| of the bands of a Laplacian
    pyramid, which counts edges at every scale."""

    name = "Laplacian pyramid"

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        difference = a - b
        total = difference.new_zeros(())
        for _ in range(4):
            lower = functional.avg_pool2d(difference, 2)
            band = difference - functional.interpolate(lower, scale_factor=2, mode="bilinear", align_corners=False)
            total = total + band.abs().mean()
            difference = lower
        return total + difference.abs().mean()


class VggLoss(nn.Module):
    """Mean |difference| of VGG-19's features after relu1_2, 2_2, 3_2, 4_2 (Johnson et al. 2016).

    `path`: torchvision's `vgg19-*.pth`. Raises GffeError if it cannot be read or holds something else.
    """

    name = "VGG-19"
    _LAYOUT = (64, 64, "M", 128, 128, "M", 256, 256, 256, 256, "M", 512, 512)
    _TAPS = (3, 8, 13, 22)

    def __init__(self, path: Path):
        super().__init__()
        layers, channels = [], 3
        for width in self._LAYOUT:
            if width == "M":
                layers.append(nn.MaxPool2d(2))
            else:
                layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU()]
                channels = width
        self.layers = nn.Sequential(*layers)
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
            state = {
                key.removeprefix("features."): value for key, value in state.items() if key.startswith("features.")
            }
            self.layers.load_state_dict({key: state[key] for key in self.layers.state_dict()})
        except UNREADABLE as error:
            raise GffeError(f"{path}: not VGG-19 as torchvision saves it ({type(error).__name__})") from None
        self.requires_grad_(False)
        self.register_buffer("mean", torch.tensor((0.485, 0.456, 0.406)).view(1, 3, 1, 1))
        self.register_buffer("deviation", torch.tensor((0.229, 0.224, 0.225)).view(1, 3, 1, 1))

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        both = (torch.cat((a, b), 0).clamp(0, 1) - self.get_buffer("mean")) / self.get_buffer("deviation")
        total = both.new_zeros(())
        for index, layer in enumerate(self.layers):
            both = layer(both)
            if index in self._TAPS:
                first, second = both.chunk(2)
                total = total + (first - second).abs().mean()
        return total


def perceptual_loss(vgg: Path | None) -> nn.Module:
    """Return the VGG loss where its weights are: at `vgg`, else in torch's cache; its substitute otherwise."""
    if vgg is None:
        found = sorted(Path(torch.hub.get_dir(), "checkpoints").glob("vgg19-*.pth"))
        vgg = found[0] if found else None
    return PyramidLoss() if vgg is None else VggLoss(vgg)
