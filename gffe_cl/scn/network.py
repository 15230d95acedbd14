"""The shading correction network (paper: 'Shading Correction Network' and its appendix).

It chooses among what might become of the shading: a U-Net at half resolution sees both frames and the trends of
shading (kernels/trend.cl), and says along which flow the GAE frame's shading moves; a head says, pixel by pixel, how
much of the trend and of that motion to take, and what to add. `compose` makes the frame of it, as
kernels/correction.cl does.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from gffe_cl.inference import INPUT_PLANES, TREND_PLANES
from gffe_cl.stages.law import HEADROOM, MU

FOCUS_THRESHOLD = 1 / 32  # a smaller M is 0
_CHANNELS = (16, 32, 48, 64)  # at 1/4 … 1/32 of the display
_DETAIL = 8
_HEAD = 16
_FLOW_UNIT = 8.0  # pixels of half resolution
_SLOPE = 0.1  # of leaky rectifiers
_LOG = torch.log1p(torch.tensor(MU)).item()
_MOST = math.log1p(65504 * MU / HEADROOM) / _LOG


def encode(color: Tensor) -> Tensor:
    """μ-law of exposed linear colour: ln(1 + μ c / 8) / ln(1 + μ); 1 at three stops above display white."""
    return torch.log1p(color.clamp(min=0) * (MU / HEADROOM)) / _LOG


def decode(encoded: Tensor) -> Tensor:
    """Inverse of `encode`; negative codes are black, and none is brighter than half floats are."""
    return torch.expm1(encoded.clamp(0, _MOST) * _LOG) * (HEADROOM / MU)


def halve(image: Tensor) -> Tensor:
    """(N, C, H, W), even sizes → means over 2×2 pixels."""
    return functional.avg_pool2d(image, 2)


def double(image: Tensor) -> Tensor:
    """Bilinear, pixel centres of both images on one plane, borders repeated."""
    return functional.interpolate(image, scale_factor=2, mode="bilinear", align_corners=False)


def warp(image: Tensor, flow: Tensor) -> Tensor:
    """(N, C, h, w) sampled at x + flow[x], (N, 2, h, w) in pixels; bilinear, borders repeated."""
    image, flow = image.float(), flow.float()
    height, width = image.shape[-2:]
    ys = torch.arange(height, dtype=flow.dtype, device=flow.device).view(1, height, 1)
    xs = torch.arange(width, dtype=flow.dtype, device=flow.device).view(1, 1, width)
    grid_x = (flow[:, 0] + (xs + 0.5)) * (2.0 / width) - 1.0
    grid_y = (flow[:, 1] + (ys + 0.5)) * (2.0 / height) - 1.0
    grid = torch.stack((grid_x, grid_y), -1)
    return functional.grid_sample(image, grid, mode="bilinear", padding_mode="border", align_corners=False)


def _conv(inputs: int, outputs: int, stride: int = 1, size: int = 3) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, size, stride, size // 2), nn.LeakyReLU(_SLOPE))


class ShadingCorrectionNetwork(nn.Module):
    """`forward(frames, alpha, trends)`.

    frames : (N, 8, h, w): encoded GAE colour (3), encoded warped previous frame (3), inverse depth, input mask; half
        resolution, h and w multiples of `MULTIPLE`
    alpha : (N,) or (1,)
    trends : (N, 7, h, w): change of encoded colour until t + α as the last interval has it (3), as the interval before
        has it (3), share of the surroundings that tells

    Returns (N, 5, h, w): Δ (3; encoded colour), keep, focus mask M. While training also p, (N, 1, h, w), of which
    M = 2 p clamped to 0 … 1: p is fitted to the true mask by L2, so it is about the probability of focus, and where
    that is more likely than not the correction counts in full. There is no sigmoid: the L2 loss would have no gradient
    where the mask is wrong.

    Δ = g₀ · trend + g₁ · (GAE frame moved along the flow − GAE frame) + δ, with gates g from 0 to 1. Every convolution
    has a multiple of four input channels: WebGPU's provider computes others wrongly.
    """

    def __init__(self):
        super().__init__()
        inputs = (INPUT_PLANES + TREND_PLANES + 1, *_CHANNELS[:-1])
        self.encoder = nn.ModuleList(
            nn.Sequential(_conv(i, o, 2), _conv(o, o)) for i, o in zip(inputs, _CHANNELS, strict=True)
        )
        pairs = zip(_CHANNELS[1:], _CHANNELS[:-1], strict=True)
        self.decoder = nn.ModuleList(_conv(coarse + fine, fine) for coarse, fine in pairs)  # finest first, as above
        self.out = nn.Conv2d(_CHANNELS[0], 2 + 4 * _DETAIL, 3, 1, 1)
        self.head = nn.Sequential(_conv(_DETAIL + 16, _HEAD, size=1), nn.Conv2d(_HEAD, 7, 1))
        self._begin()

    @torch.no_grad()
    def _begin(self) -> None:
        """Weights of a network that changes little yet, and whose signals neither fade nor grow from layer to layer."""
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, _SLOPE)
                nn.init.zeros_(module.bias)
        self.out.weight[:2] *= 0.1
        self.head[1].weight *= 0.1
        self.head[1].bias.copy_(torch.tensor((-0.85, -0.85, 0.0, 0.0, 0.0, 2.0, 0.05)))  # gates of 0.3

    def forward(self, frames: Tensor, alpha: Tensor, trends: Tensor):
        now, before, mask = frames[:, :3], frames[:, 3:6], frames[:, 7:8]
        time = torch.zeros_like(mask) + alpha.view(-1, 1, 1, 1)
        features = [torch.cat((frames, trends, time), 1)]
        for level in self.encoder:
            features.append(level(features[-1]))
        result = features.pop()
        for level in reversed(self.decoder):
            result = level(torch.cat((double(result), features.pop()), 1))
        out = self.out(result)
        moved = warp(now, _FLOW_UNIT * double(out[:, :2])) - now
        detail = functional.leaky_relu(functional.pixel_shuffle(out[:, 2:], 2), _SLOPE)
        said = self.head(torch.cat((detail, moved, trends[:, :6], now, before, mask), 1)).float()
        gates = torch.sigmoid(said[:, :2])
        delta = gates[:, :1] * trends[:, :3] + gates[:, 1:] * moved + said[:, 2:5]
        keep, likely = torch.sigmoid(said[:, 5:6]), said[:, 6:]
        correction = torch.cat((delta, keep, (2 * likely).clamp(0, 1)), 1)
        return (correction, likely) if self.training else correction


def compose(color: Tensor, correction: Tensor, focus_mask: bool = True) -> tuple[Tensor, Tensor, Tensor]:
    """The corrected frame at full resolution, from exposed linear GAE `color` (N, 3, H, W) and the network's output.

    The correction is added to the image at half resolution; `keep` says how much of the detail between the two
    resolutions stays. `color` at half resolution has none. Returns refined, final (both linear) and the focus mask
    (N, 1, H, W), 0 below `FOCUS_THRESHOLD`.
    """
    encoded = encode(color)
    if color.shape[-2:] == correction.shape[-2:]:
        delta, _, mask = correction.split((3, 1, 1), 1)
        refined = decode(encoded + delta)
    else:
        low = double(halve(encoded))
        delta, keep, mask = double(correction).split((3, 1, 1), 1)
        refined = decode(low + delta + keep * (encoded - low))
    mask = torch.where(mask < FOCUS_THRESHOLD, torch.zeros_like(mask), mask)
    return refined, (color + mask * (refined - color) if focus_mask else refined), mask
