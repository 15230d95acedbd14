"""The shading correction network (paper: 'Shading Correction Network' and its appendix).

Flow-based, coarse to fine, all of it at half resolution: an encoder of four feature levels (the paper has three, but
shading may move far) is shared by the GAE frame and the warped previous frame; a decoder per level predicts two flows,
and the features of the frame at t + α; a head makes the correction, of what moves along the flow and of the trends of
shading (kernels/trend.cl). `compose` makes the frame of it, as kernels/correction.cl does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from gffe_cl.scn.flow import find_flow
from gffe_cl.scn.images import double, halve, warp
from gffe_cl.stages.law import HEADROOM, MU

FOCUS_THRESHOLD = 1 / 32  # a smaller M is 0
_CHANNELS = (16, 32, 48, 64)
_HIDDEN = (32, 48, 64, 64)
_DETAIL = 4
_CANDIDATES = 16  # channels of what is known about the candidates
_FOLLOW, _LASTS = 2, 3  # channels of the finest decoder: how far the found flow is followed, how far the trend lasts
_HEAD = 16
_LITTLE = 1e-4  # squared change of encoded colour
_SLOPE = 0.1  # of leaky rectifiers
_LOG = torch.log1p(torch.tensor(MU)).item()
_MOST = math.log1p(65504 * MU / HEADROOM) / _LOG


def encode(color: Tensor) -> Tensor:
    """μ-law of exposed linear colour: ln(1 + μ c / 8) / ln(1 + μ); 1 at three stops above display white."""
    return torch.log1p(color.clamp(min=0) * (MU / HEADROOM)) / _LOG


def decode(encoded: Tensor) -> Tensor:
    """Inverse of `encode`; negative codes are black, and none is brighter than half floats are."""
    return torch.expm1(encoded.clamp(0, _MOST) * _LOG) * (HEADROOM / MU)


def _conv(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, 1), nn.LeakyReLU(_SLOPE))


class Encoder(nn.Module):
    """(N, 8, h, w): encoded colour, its difference from the other frame, inverse depth, input mask → features at
    1/2 … 1/16 of that size.

    On one surface the two frames differ by their shading only: the difference is what moves.
    """

    def __init__(self):
        super().__init__()
        inputs = (8, *_CHANNELS[:-1])
        self.levels = nn.ModuleList(
            nn.Sequential(_conv(i, o, 2), _conv(o, o)) for i, o in zip(inputs, _CHANNELS, strict=True)
        )

    def forward(self, frames: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Features of the GAE frame and of the warped previous frame, from finest to coarsest, of `frames` (N, 8, h, w)
        as the network has them. What is linear goes into the first weights: images are read as they are."""
        first, *rest = self.levels[0][0]
        color, change, side = first.weight.split((3, 3, 2), 1)
        own, other = color + change, -change
        features = []
        for images in ((own, other, side), (other, own, side)):
            found = functional.conv2d(frames, torch.cat(images, 1), first.bias, first.stride, first.padding)
            found = self.levels[0][1](*(layer(found) for layer in rest))
            features.append([found])
            for level in self.levels[1:]:
                features[-1].append(level(features[-1][-1]))
        return list(zip(*features, strict=True))


class Decoder(nn.Module):
    """Flows (4 channels: into the GAE frame, into the warped previous frame) and features of the frame at t + α.

    `seen`: channels of each of the two images, which are warped by the coarser flows; `beside`: of what is not.
    Below the coarsest level `inputs` are convolved, a multiple of 16: onnxruntime takes twice as long for others.
    """

    def __init__(
        self, seen: int, beside: int, channels: int, coarser: int, hidden: int, inputs: int = 0, candidates: int = 0
    ):
        super().__init__()
        given = 2 * seen + beside
        self.squeeze = nn.Conv2d(coarser, inputs - given - 4 - candidates, 1) if coarser else None
        self.body = nn.Sequential(_conv(inputs if coarser else given, hidden), _conv(hidden, hidden))
        self.out = nn.Conv2d(hidden, channels, 3, 1, 1)

    def forward(self, now, before, beside, coarser=None, candidates=()) -> tuple[Tensor, Tensor]:
        """`coarser`: what the level above returned: flows, and all its channels, the features after the first four."""
        if coarser is None:
            out = self.out(self.body(torch.cat((now, before, beside), 1)))
            return out[:, :4].float(), out
        flows = 2.0 * double(coarser[0])
        moved = warp(now, flows[:, :2]), warp(before, flows[:, 2:])
        out = self.out(self.body(torch.cat((*moved, beside, flows, double(self.squeeze(coarser[1])), *candidates), 1)))
        return out[:, :4].float() + flows, out


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

    Δ = (GAE frame moved along the flow − GAE frame) + g · trend, as far as that has lasted, + δ. Every convolution has
    a multiple of four input channels: WebGPU's provider computes others wrongly.
    """

    def __init__(self):
        super().__init__()
        self.encoder = Encoder()
        finest = Decoder(3, _CHANNELS[0] + 6, _CHANNELS[0], _CHANNELS[1], _HIDDEN[0], 4 * _CHANNELS[0], _CANDIDATES)
        self.decoders = nn.ModuleList([finest])
        for channels, coarser, hidden in zip(_CHANNELS[1:-1], _CHANNELS[2:], _HIDDEN[1:], strict=False):
            self.decoders.append(Decoder(channels // 2, 3, channels, coarser, hidden, 2 * channels))
        self.decoders.append(Decoder(_CHANNELS[-1], 4, _CHANNELS[-1], 0, _HIDDEN[-1]))
        self.up = nn.Conv2d(_CHANNELS[0], 4 * _DETAIL, 3, 1, 1)
        self.head = nn.Sequential(_conv(_DETAIL + 12, _HEAD), nn.Conv2d(_HEAD, 6, 1))
        self._begin()

    @torch.no_grad()
    def _begin(self) -> None:
        """Weights of a network that changes little yet, and whose signals neither fade nor grow from layer to layer."""
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, _SLOPE)
                nn.init.zeros_(module.bias)
        for decoder in self.decoders:
            decoder.out.weight[:4] *= 0.1
        self.head[1].weight *= 0.1
        self.head[1].bias.copy_(torch.tensor((0.0, 0.0, 0.0, 2.0, 0.05, 0.0)))

    @torch.no_grad()
    def take(self, weights: Mapping[str, np.ndarray]) -> None:
        """Begin with `weights` by the parameters' names; inputs and outputs that they do not have count for nothing
        yet. Raises ValueError for those of another network."""
        for name, parameter in self.named_parameters():
            given = weights.get(name)
            if given is None or given.ndim != parameter.ndim or any(np.greater(given.shape, parameter.shape)):
                raise ValueError(f"'{name}' is {'missing' if given is None else list(given.shape)}")
            parameter.zero_()
            parameter[tuple(slice(n) for n in given.shape)] = torch.from_numpy(np.array(given))

    def forward(self, frames: Tensor, alpha: Tensor, trends: Tensor):
        now, before = frames[:, :3], frames[:, 3:6]
        encoded = self.encoder(frames)
        time = alpha.view(-1, 1, 1, 1)
        smaller = [halve(frames)]
        found, held, candidates = _candidates(smaller[0], halve(trends), time)
        while len(smaller) < len(self.decoders):
            smaller.append(halve(smaller[-1]))
        result = None
        for k in reversed(range(len(self.decoders))):
            small = smaller[k]
            plane = torch.zeros_like(small[:, :1])
            beside = torch.cat((small[:, 6:], plane + time) if result else (small[:, 6:], plane + time, plane), 1)
            images = encoded[k]
            if k == 0:  # warping features would cost a quarter of the network's time
                beside = torch.cat((beside, images[0], small[:, :3]), 1)
                images = small[:, :3], small[:, 3:6]
            elif result:
                images = (image[:, : _CHANNELS[k] // 2] for image in images)
            result = self.decoders[k](*images, beside, result, () if k else (candidates,))
        result, out = result[0], result[1]
        follow = torch.sigmoid(out[:, _FOLLOW : _FOLLOW + 1].float() - 2.0)
        flows = 2.0 * double(result[:, :2] + follow * (time * found - result[:, :2]))
        detail = functional.pixel_shuffle(functional.leaky_relu(self.up(out), _SLOPE), 2)
        moved = warp(now, flows)
        lasting = trends[:, :3] * double((held + out[:, _LASTS : _LASTS + 1].float()).clamp(0, 1))
        out = self.head(torch.cat((detail, now, before, moved, lasting), 1)).float()
        delta = out[:, :3] + (moved - now) + out[:, 5:6] * lasting
        keep, likely = torch.sigmoid(out[:, 3:4]), out[:, 4:5]
        correction = torch.cat((delta, keep, (2 * likely).clamp(0, 1)), 1)
        return (correction, likely) if self.training else correction


def _candidates(frames: Tensor, trends: Tensor, time: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """At a quarter of the resolution: the flow from the GAE frame into the warped previous one (2), as far as the last
    interval's trend was that of the interval before (1), and what the decoder is to know about both (`_CANDIDATES`)."""
    now, before = frames[:, :3], frames[:, 3:6]
    with torch.no_grad():  # of inputs alone
        found, differences = find_flow(now.mean(1, keepdim=True), before.mean(1, keepdim=True))
        still, along = (differences + 1e-6).split(1, 1)
        moved = warp(now, time * found)
        trend, earlier, share = trends.split((3, 3, 1), 1)
        held = (trend * earlier).sum(1, keepdim=True) / ((trend * trend).sum(1, keepdim=True) + _LITTLE)
        held = held.clamp(0, 1)
        size = found.square().sum(1, keepdim=True).sqrt()
        known = (found / 4, size / 4, 4 * still.sqrt(), 4 * along.sqrt(), along / still, 4 * (moved - now), 4 * trend,
                 4 * earlier.mean(1, keepdim=True), 4 * (now - before).mean(1, keepdim=True), held, share)  # fmt: skip
    return found, held, torch.cat(known, 1)


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
