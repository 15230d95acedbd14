"""The shading correction network (paper: 'Shading Correction Network' and its appendix).

Two changes of shading may continue: movement, along the flow that `find_flow` finds from the GAE frame into the
warped previous one, coarse to fine, and trends over wide areas (kernels/shading_trend.cl). The network judges per pixel
how far. Its input are both frames and the confidence in both candidates; four levels of features work at a quarter of
the display's resolution and below; a head at half resolution makes the correction. `compose` applies it to the frame,
as kernels/correction.cl does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from gffe_cl.engine.inference.layers import CANDIDATE_PLANES, HEAD_LAYERS, INPUT_PLANES, JUDGEMENT_PLANES
from gffe_cl.engine.stages.frame_block import HEADROOM, MU

FOCUS_THRESHOLD = 1 / 32  # a smaller M is 0
_CHANNELS = (16, 32, 48, 64)  # at 1/4 … 1/32 of the display
_SEEN = 16  # channels from the frames themselves, at a quarter
_JUDGED = 4  # channels of the judgement before the detail
_DOUBT = 0.1
_TEXTURE, _TEXTURE_CHANGE, _FAINT = 1.25, 2.5, 1e-5  # of detail that both frames have: as in the kernels
_MARGIN = 2.0  # how much farther than it changed light may go on
_TRUSTED, _DISTRUST = 3.0, 4.0  # the focus mask: by the squared difference of two intervals' changes to that of one
_LITTLE = 1e-4  # squared change of encoded color
_SLOPE = 0.1  # of leaky rectifiers
_LOG = torch.log1p(torch.tensor(MU)).item()
_MOST = math.log1p(65504 * MU / HEADROOM) / _LOG


# ---- images --------------------------------------------------------------------------------------------


def halve(image: Tensor) -> Tensor:
    """Return means over 2×2 pixels of an image (N, C, H, W) with even sizes."""
    return functional.avg_pool2d(image, 2)


def double(image: Tensor) -> Tensor:
    """Return an image of twice the size: bilinear, pixel centers of both images on one plane, borders repeated."""
    return functional.interpolate(image, scale_factor=2, mode="bilinear", align_corners=False)


def warp(image: Tensor, flow: Tensor) -> Tensor:
    """Return an image (N, C, H, W) sampled at x + flow[x], (N, 2, h, w) in pixels of the image; bilinear, borders
    repeated. The flow may have a lower resolution: pixel centers of both lie on one plane."""
    image, flow = image.float(), flow.float()
    height, width = flow.shape[-2:]
    ys = torch.arange(height, dtype=flow.dtype, device=flow.device).view(1, height, 1)
    xs = torch.arange(width, dtype=flow.dtype, device=flow.device).view(1, 1, width)
    grid_x = flow[:, 0] * (2.0 / image.shape[-1]) + (xs + 0.5) * (2.0 / width) - 1.0
    grid_y = flow[:, 1] * (2.0 / image.shape[-2]) + (ys + 0.5) * (2.0 / height) - 1.0
    grid = torch.stack((grid_x, grid_y), -1)
    return functional.grid_sample(image, grid, mode="bilinear", padding_mode="border", align_corners=False)


def encode(color: Tensor) -> Tensor:
    """Return the μ-law of exposed linear color: ln(1 + μ c / 8) / ln(1 + μ); 1 at three stops above display white."""
    return torch.log1p(color.clamp(min=0) * (MU / HEADROOM)) / _LOG


def decode(encoded: Tensor) -> Tensor:
    """Return the inverse of `encode`; negative codes are black, and none is brighter than half floats are."""
    return torch.expm1(encoded.clamp(0, _MOST) * _LOG) * (HEADROOM / MU)


class _Convolution(nn.Conv2d):
    """Convolution layer. `weight_rounding`, if given, maps the weights to those in use."""

    weight_rounding: Callable[[Tensor], Tensor] | None = None

    def forward(self, image: Tensor) -> Tensor:
        weight = self.weight_rounding(self.weight) if self.weight_rounding else self.weight
        return functional.conv2d(image, weight, self.bias, self.stride, self.padding)


def _conv(inputs: int, outputs: int, stride: int = 1, size: int = 3) -> nn.Sequential:
    return nn.Sequential(_Convolution(inputs, outputs, size, stride, size // 2), nn.LeakyReLU(_SLOPE))


class _Joined(nn.Module):
    """Concatenation of the channels of several images of one size. As a module, its output can be rounded."""

    def forward(self, *images: Tensor) -> Tensor:
        return torch.cat(images, 1)


class _Doubled(nn.Module):
    def forward(self, image: Tensor) -> Tensor:
        return double(image)


class ConvolutionLayers(nn.Module):
    """The convolutions of the network, stored in the ONNX file. `forward(frames, candidates)` returns the judgement,
    (N, 20, h/2, w/2), see `ShadingCorrectionNetwork`."""

    def __init__(self):
        super().__init__()
        self.seen, self.given = _conv(INPUT_PLANES, _SEEN, 2), nn.Identity()
        self.encoder = nn.ModuleList([_conv(_SEEN + CANDIDATE_PLANES, _CHANNELS[0])])
        for i, o in zip(_CHANNELS[:-1], _CHANNELS[1:], strict=True):
            self.encoder.append(nn.Sequential(_conv(i, o, 2), _conv(o, o)))
        pairs = list(zip(_CHANNELS[1:], _CHANNELS[:-1], strict=True))  # finest first, as above
        self.narrow = nn.ModuleList(_conv(coarse, fine, size=1) for coarse, fine in pairs)
        self.decoder = nn.ModuleList(_conv(2 * fine, fine) for _, fine in pairs)
        self.doubled = nn.ModuleList(_Doubled() for _ in pairs)
        self.joined = nn.ModuleList(_Joined() for _ in range(1 + len(pairs)))  # the last: before the encoder
        self.out = nn.Conv2d(_CHANNELS[0], JUDGEMENT_PLANES, 1)

    def forward(self, frames: Tensor, candidates: Tensor) -> Tensor:
        features = [self.joined[-1](self.seen(frames), self.given(candidates))]
        for level in self.encoder:
            features.append(level(features[-1]))
        result = features.pop()
        for k in reversed(range(len(self.decoder))):
            coarse = self.doubled[k](self.narrow[k](result))
            result = self.decoder[k](self.joined[k](coarse, features.pop()))
        return self.out(result)


class ShadingCorrectionNetwork(nn.Module):
    """The shading correction network, called with `forward(frames, alpha, trends)`.

    frames : (N, 8, h, w): encoded GAE color (3), encoded warped previous frame (3), inverse depth, input mask; half
        resolution, h and w multiples of `MULTIPLE`
    alpha : (N,) or (1,)
    trends : (N, 8, h/2, w/2): change of encoded color until t + α as the last interval has it (3), as the interval
        before has it (3), share of the surroundings that is evidence; change of brightness close by in the interval
        before

    Returns (N, 5, h, w): Δ (3; encoded color), keep, focus mask M. While training also p, (N, 1, h, w), of which
    M = 2 p − 0.1 clamped to 0 … 1: nothing is touched where there is little to gain. There is no sigmoid: where the
    mask is wrong it would have no gradient.

    Δ = `moved_light` + g · trend, as far as it lasts, + δ; the flow is a mean of the one that was found, α of it, and
    the network's own. In the pipeline all but `convolutions` are kernels: kernels/shading_flow.cl,
    kernels/correction.cl.
    """

    def __init__(self):
        super().__init__()
        self.convolutions = ConvolutionLayers()
        (hidden, seen), (said, _) = HEAD_LAYERS
        self.head = nn.Sequential(_conv(seen, hidden, size=1), nn.Conv2d(hidden, said, 1))
        self._begin()

    @torch.no_grad()
    def _begin(self) -> None:
        """Set the initial weights: the network changes little yet, and signals neither fade nor grow from layer to
        layer."""
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, _SLOPE)
                assert module.bias is not None
                nn.init.zeros_(module.bias)
        self.convolutions.out.weight[:_JUDGED] *= 0.1
        last: Any = self.head[1]
        last.weight *= 0.1
        last.bias.copy_(torch.tensor((0.0, 0.0, 0.0, 2.0, 0.15, 0.3)))

    def head_weights(self) -> np.ndarray:
        """Return the weights of the head, (374,): of each layer rows, then biases."""
        parameters = [parameter.detach().cpu().numpy().ravel() for parameter in self.head.parameters()]
        return np.concatenate(parameters).astype(np.float32)

    @torch.no_grad()
    def take(self, weights: Mapping[str, np.ndarray], head: np.ndarray) -> None:
        """Load `weights` of the convolutions by the parameters' names, and those of the `head`. Inputs and outputs that
        they do not have count for nothing yet. Raises ValueError for those of another network."""
        for name, parameter in self.convolutions.named_parameters():
            given = weights.get(name)
            if given is None or given.ndim != parameter.ndim or any(np.greater(given.shape, parameter.shape)):
                raise ValueError(f"'{name}' is {'missing' if given is None else list(given.shape)}")
            parameter.zero_()
            parameter[tuple(slice(n) for n in given.shape)] = torch.from_numpy(np.array(given))
        sizes = [parameter.numel() for parameter in self.head.parameters()]
        if len(head) != sum(sizes):
            raise ValueError(f"its head has {len(head)} weights")
        for parameter, part in zip(self.head.parameters(), np.split(head, np.cumsum(sizes)[:-1]), strict=True):
            parameter.copy_(torch.from_numpy(part).view_as(parameter))

    def forward(self, frames: Tensor, alpha: Tensor, trends: Tensor):
        now, before = frames[:, :3], frames[:, 3:6]
        time = alpha.view(-1, 1, 1, 1)
        found, held, trusted, candidates = find_candidates(halve(frames[:, :6]), trends, time)
        judgement = self.convolutions(frames, candidates).float()
        _, follow, lasts, detail = judgement.split((2, 1, 1, JUDGEMENT_PLANES - _JUDGED), 1)
        flow = torch.sigmoid(follow) * (time * found)
        moved = moved_light(now, before, 2.0 * double(flow))
        trend = double(trends[:, :3]) * double((held + lasts).clamp(0, 1))
        detail = functional.leaky_relu(functional.pixel_shuffle(detail, 2), _SLOPE)
        said = self.head(torch.cat((detail, moved, trend, now, before), 1)).float()
        delta = said[:, :3] + moved + said[:, 5:6] * trend
        keep, likely = torch.sigmoid(said[:, 3:4]), said[:, 4:5]
        keep = keep + (1 - keep) * double(find_texture(now, before))
        mask = (2 * likely - _DOUBT).clamp(0, 1) * double(trusted)
        correction = torch.cat((delta, keep, mask), 1)
        return (correction, likely) if self.training else correction


def find_texture(now: Tensor, before: Tensor) -> Tensor:
    """Return how far the detail of brightness within 2×2 pixels is the same in both frames (N, 3, h, w): 0 to 1,
    (N, 1, h/2, w/2). It is texture of the surface then, which a change of light leaves."""
    with torch.no_grad():  # of inputs alone
        both = [functional.pixel_unshuffle(image.mean(1, keepdim=True), 2) for image in (now, before)]
        now, before = (parts - parts.mean(1, keepdim=True) for parts in both)
        change, power = ((now - before) ** 2).sum(1, keepdim=True), (now**2 + before**2).sum(1, keepdim=True)
        return (_TEXTURE - _TEXTURE_CHANGE * change / (power + _FAINT)).clamp(0, 1)


def moved_light(now: Tensor, before: Tensor, flow: Tensor) -> Tensor:
    """Return the difference (N, 3, h, w) of `now`, moved along `flow` (N, 2, h, w; pixels), from `now` itself, limited
    to twice the change from `before` to `now` here and where the flow leads. Texture is in both frames, so it does not
    move where light is constant."""
    there, before_there = warp(torch.cat((now, before), 1), flow).split(3, 1)
    moved, changed, changed_there = there - now, _MARGIN * (now - before), _MARGIN * (there - before_there)
    none = torch.zeros_like(moved)
    least = torch.minimum(torch.minimum(changed, changed_there), none)
    most = torch.maximum(torch.maximum(changed, changed_there), none)
    return torch.minimum(torch.maximum(moved, least), most)


def find_candidates(frames: Tensor, trends: Tensor, time: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return, at a quarter of the resolution: the flow from the GAE frame into the warped previous one (2), the
    agreement of the last interval's trend with the interval before (1), the trust in the focus mask (1), and the
    confidence in both candidates (`CANDIDATE_PLANES`).

    Flickering light is not trusted: there the last interval's change of brightness differs from that of the interval
    before, both in place and along the flow.
    """
    now, before = frames[:, :3], frames[:, 3:6]
    with torch.no_grad():  # of inputs alone
        trend, earlier, share, repeated = trends.split((3, 3, 1, 1), 1)
        found, differences = find_flow(now.mean(1, keepdim=True), before.mean(1, keepdim=True), repeated)
        still, along, again, again_along = (differences + 1e-6).split(1, 1)
        moved = warp(now, time * found)
        held = (trend * earlier).sum(1, keepdim=True) / ((trend * trend).sum(1, keepdim=True) + _LITTLE)
        held = held.clamp(0, 1)
        known = (
            found / 4,
            4 * still.sqrt(),
            4 * along.sqrt(),
            along / still,
            4 * (moved - now),
            4 * trend,
            4 * earlier.mean(1, keepdim=True),
            4 * (now - before).mean(1, keepdim=True),
            held,
            share,
            torch.zeros_like(share) + time,
        )
        trusted = (_TRUSTED - _DISTRUST * torch.minimum(again, again_along) / still).clamp(0, 1)
    return found, held, trusted, torch.cat(known, 1)


def compose(color: Tensor, correction: Tensor, focus_mask: bool = True) -> tuple[Tensor, Tensor, Tensor]:
    """Return the corrected frame at full resolution, from exposed linear GAE `color` (N, 3, H, W) and the network's
    output.

    The correction is added to the image at half resolution; `keep` is the share of the detail between the two
    resolutions that stays. `color` at half resolution has none. The result is refined, final (both linear) and the
    focus mask (N, 1, H, W), 0 below `FOCUS_THRESHOLD`.
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


# ---- flow ----------------------------------------------------------------------------------------------

_LEVELS = 3
_STEPS = 2  # per level
_FLAT = 1e-4  # squared gradient of encoded color below which nothing moves
_LONGEST = 2.0  # pixels of a step


def find_flow(now: Tensor, before: Tensor, repeated: Tensor) -> tuple[Tensor, Tensor]:
    """Return the flow and its errors. The content at x in `now` is at x + flow[x] in `before`, both (N, 1, h, w), sides
    multiples of 8.

    The flow is (N, 2, h, w) in pixels. The errors are (N, 4, h, w) mean squared differences around: of `now` from
    `before` as it is and along the flow, and of that change from the one of the interval before, `repeated` (N, 1, h,
    w), as it is and along the flow. Sums are over some 6×6 pixels of each level; the flow of every second pixel is
    found.
    """
    images = [(now, before)]
    while len(images) < _LEVELS:
        a, b = images[-1]
        images.append((halve(a), halve(b)))
    flow = None
    for a, b in reversed(images):
        height, width = a.shape[-2] // 2, a.shape[-1] // 2
        flow = a.new_zeros(a.shape[0], 2, height, width) if flow is None else 2.0 * double(flow)
        for _ in range(_STEPS):
            flow = flow + _step(a, warp(b, double(flow)))
    assert flow is not None
    finest = double(flow)
    squares = halve(torch.cat((before - now, warp(before, finest) - now), 1).square())
    changed = halve(now - before)
    again = torch.cat((changed - halve(repeated), changed - warp(repeated, flow)), 1).square()
    return finest, double(_means(torch.cat((squares, again), 1)))


def _step(a: Tensor, b: Tensor) -> Tensor:
    """Return by how much to move b, by least squares, to equal a; at half the resolution, in pixels of a."""
    x, y = _gradient(a + b)
    rest = 4.0 * (b - a)
    xx, xy, yy, xr, yr = _mean_around(torch.cat((x * x, x * y, y * y, x * rest, y * rest), 1)).split(1, 1)
    xx, yy = xx + _FLAT, yy + _FLAT
    step = torch.cat((xy * yr - yy * xr, xy * xr - xx * yr), 1) / (xx * yy - xy * xy)
    return step / (step.abs().amax(1, keepdim=True) / _LONGEST).clamp(min=1)


def _gradient(image: Tensor) -> tuple[Tensor, Tensor]:
    """Return twice the gradient along x and y."""
    padded = functional.pad(image, (1, 1, 1, 1), mode="replicate")
    return padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2], padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1]


def _mean_around(image: Tensor) -> Tensor:
    """Return means of 3×3 pixels at half the resolution."""
    return _means(halve(image))


def _means(image: Tensor) -> Tensor:
    """Return means of the 3×3 pixels around each, or at borders of those that exist."""
    return functional.avg_pool2d(image, 3, 1, 1, count_include_pad=False)
