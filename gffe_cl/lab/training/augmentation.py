"""Augmentation of training batches: mirrored and turned, other exposures and hues, noise, and shading that moves."""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.shading import TREND_PLANES, spacing_of
from gffe_cl.lab.training.data import CROP, DYNAMIC, Batch
from gffe_cl.lab.training.network import decode, encode, halve

_CONSTANTS = constants("shading_trend.cl")
_CELL, _LEAST_SHARE = _CONSTANTS["CELL"], _CONSTANTS["LEAST_SHARE"]
_KNOWN = 0.25  # input masks farther than this from that of static, shown pixels are others' or mixed
_UNKNOWN_BEFORE = 0.08  # share of crops that are taken as from the second frame after a reset


class Augmentation:
    """Random variation of batches: mirroring, rotation, exposure, hue, noise, and additional shading.

    The additional shading stands for lights, unseen casters and reflections. On pixels that are not dynamic, a pattern
    multiplies (shadows, pools of light) or is added to (reflections) each frame, as the pattern is at its time. All
    frames of a sample show the geometry at t + α, so shading that moves by v pixels per interval is at x in the GAE
    frame, at x − v in the warped previous frame, at x + α v in the truth, and at x − 2 v in the frame before, of which
    only the trend is known. Trends follow as the stage `ShadingTrend` would find them.

    Batches are on the device of `generator`. `shading`: how often a crop gets any; two fifths of these have lights that
    switch. `changing`: the share of patterns that do not move steadily: they jump, are somewhere else in every frame,
    flicker or fade. Of these only fading continues.
    """

    def __init__(self, generator: torch.Generator, shading: float = 0.6, noise: float = 0.25, changing: float = 1 / 3):
        self.generator, self.shading, self.noise, self.changing = generator, shading, noise, changing

    def __call__(self, batch: Batch) -> Batch:
        with self.generator.device:
            return self._varied(batch)

    def _varied(self, batch: Batch) -> Batch:
        alpha = batch.alpha
        earlier = _earlier(batch)
        colors = torch.stack((batch.gae, batch.previous, batch.truth, earlier))  # (4, N, 3, H, W)
        colors, side, trends = self._turned(colors, batch.side, batch.trends)
        count = colors.shape[1]
        hue = torch.stack([torch.randperm(3, generator=self.generator) for _ in range(count)])
        colors = colors.gather(2, hue.view(1, count, 3, 1, 1).expand_as(colors))
        rest = torch.arange(6, TREND_PLANES).expand(count, -1)
        order = torch.cat((hue, 3 + hue, rest), 1).view(count, TREND_PLANES, 1, 1)
        trends = trends.gather(1, order.expand_as(trends))
        before = _changes(colors, batch.halved)
        colors = colors * torch.exp2(self._uniform((1, count, 3, 1, 1), -0.3, 0.3))
        for change, share in ((self._reflected, 0.4), (self._switched, 0.4), (self._lit, 1.0), (self._lit, 0.4)):
            some = self._some(count, share * self.shading)
            if len(some):
                colors[:, some] = change(colors[:, some], side[some], alpha[some])
        colors = (colors * torch.exp2(self._uniform((1, count, 1, 1, 1), -1.5, 1.0))).clamp_(0, 60000)
        changed = _changes(colors, batch.halved) - before
        static = side[:, 1:] if batch.halved else halve(side[:, 1:])
        known = ((static - 0.5).abs() < _KNOWN).float()
        trends[:, :6] += alpha.view(-1, 1, 1, 1) * low_pass(changed, known, batch.heights)
        trends[:, 7:8] += low_pass(changed[:, 3:].mean(1, keepdim=True), known)
        some = self._some(count, _UNKNOWN_BEFORE)
        trends[some, 3:6] = 0
        trends[some, 7:] = 0
        some = self._some(count, self.noise)
        if len(some):
            colors[:2, some] = self._grainy(colors[:2, some])
        gae, previous, truth = colors[:3]
        return Batch(gae, previous, truth, side, trends, alpha, batch.heights, batch.halved)

    def _turned(self, colors: Tensor, *others: Tensor) -> list[Tensor]:
        """Return all images mirrored either way, and transposed, at random."""
        images = [colors, *others]
        for change in (lambda x: x.flip(-1), lambda x: x.flip(-2), lambda x: x.transpose(-1, -2)):
            if self._chance() < 0.5:
                images = [change(image) for image in images]
        images[-1] = images[-1].clone()  # is changed in place
        return images

    def _chance(self) -> float:
        return torch.rand((), generator=self.generator).item()

    def _uniform(self, shape, low: float, high: float) -> Tensor:
        return torch.rand(shape, generator=self.generator) * (high - low) + low

    def _some(self, count: int, share: float) -> Tensor:
        """Return indices of samples, each with probability `share`."""
        return (torch.rand(count, generator=self.generator) < share).nonzero()[:, 0]

    def _grainy(self, colors: Tensor) -> Tensor:
        """Return the inputs (not the truth) with a path tracer's noise; less of it in the resampled GAE frame."""
        amount = torch.exp2(self._uniform((1, colors.shape[1], 1, 1, 1), -9, -5.5)) * (colors.shape[-1] / CROP)
        grain = torch.randn(colors.shape, generator=self.generator) * torch.tensor((0.6, 1.0)).view(2, 1, 1, 1, 1)
        return (colors + grain * amount * (0.02 + colors).sqrt()).clamp(min=0)

    def _course(self, count: int, alpha: Tensor) -> tuple[Tensor, Tensor]:
        """Return the course of patterns: where they are along their way, in intervals, and how strong, each (4, N), at
        t, t − 1, t + α and t − 2."""
        times = torch.stack((torch.zeros(count), -torch.ones(count), alpha, torch.full((count,), -2.0)))
        strength = torch.ones(4, count)
        kind = torch.rand(count, generator=self.generator) / max(self.changing, 1e-9)  # 1 and more: steady
        elsewhere = self._uniform((4, count), -3.0, 3.0)
        times = torch.where(kind < 0.3, elsewhere, times)
        jumps = (kind >= 0.3) & (kind < 0.4)
        times[2] = torch.where(jumps, elsewhere[2], times[2])
        strength = torch.where((kind >= 0.4) & (kind < 0.7), self._uniform((4, count), 0.0, 1.0), strength)
        fading = self._uniform((count,), 0.2, 0.8) + times * self._uniform((count,), -0.4, 0.4)
        return times, torch.where((kind >= 0.7) & (kind < 1.0), fading.clamp(0, 1), strength)

    def _grids(self, times: Tensor, height: int, width: int) -> Tensor:
        """Return sampling positions (4, N, H, W, 2) of moving patterns at these times (4, N); a pattern is 2 × 2 around
        0."""
        count = times.shape[1]
        speed = torch.exp2(self._uniform((count,), -1.0, 6.3))  # pixels of the whole frame per interval
        heading, turned = self._uniform((2, count), -torch.pi, torch.pi)
        velocity = torch.stack((heading.cos(), heading.sin()), -1) * speed[:, None] * (2.0 / CROP)
        spin = self._uniform((count,), -0.03, 0.03)
        zoom = self._uniform((count,), -0.03, 0.03)
        bend = self._uniform((count,), -0.12, 0.12)  # speeds change a little
        ys, xs = torch.linspace(-1, 1, height), torch.linspace(-1, 1, width)
        plane = torch.stack(torch.meshgrid(xs, ys, indexing="xy"), -1)
        start = self._uniform((count, 1, 1, 2), -0.3, 0.3)
        grids = []
        for time in times:
            gone = time + bend * time * time.abs()
            angle, scale = turned + spin * gone, torch.exp(zoom * gone)
            cos, sin = (angle.cos() * scale).view(-1, 1, 1), (angle.sin() * scale).view(-1, 1, 1)
            moved = plane - (velocity * gone[:, None]).view(-1, 1, 1, 2)
            x, y = moved.unbind(-1)
            grids.append(torch.stack((cos * x - sin * y, sin * x + cos * y), -1) + start)
        return torch.stack(grids)

    def _moved(self, image: Tensor, grids: Tensor) -> Tensor:
        """Return `image` (N, C, h, w) at the four times: (4, N, C, H, W)."""
        return torch.stack(
            [
                functional.grid_sample(image, grid, mode="bilinear", padding_mode="reflection", align_corners=False)
                for grid in grids
            ]
        )

    def _lit(self, colors: Tensor, side: Tensor, alpha: Tensor) -> Tensor:
        """Return the frames with shadows and pools of light, from one large blob to foliage and bars, of sharp or soft
        edges."""
        _, count, _, height, width = colors.shape
        size = height * 5 // 4  # of the pattern
        cells = 2 ** int(torch.randint(1, 6, (), generator=self.generator))
        coarse = torch.randn((count, 1, 2 + cells, 2 + cells), generator=self.generator)
        field = functional.interpolate(coarse, (size, size), mode="bicubic", align_corners=False)
        bars = self._some(count, 0.3)
        waves = torch.linspace(-1, 1, size) * torch.exp2(self._uniform((len(bars), 1, 1, 1), 2.0, 5.5))
        field[bars] = torch.sin(waves).expand(-1, -1, size, -1)
        field += self._uniform((count, 1, 1, 1), -0.5, 0.7)
        slope = (field[..., 1:] - field[..., :-1]).abs().mean((1, 2, 3), keepdim=True) * (size / CROP)
        softness = torch.exp2(self._uniform((count, 1, 1, 1), 0.0, 4.5)) * slope  # edges of 1 to 20 pixels
        times, strength = self._course(count, alpha)
        shape = self._moved(field, 0.8 * self._grids(times, height, width))
        shape = torch.sigmoid(3 * shape / softness) * strength.view(4, -1, 1, 1, 1) * (side[:, 1:] <= DYNAMIC)
        dark = self._uniform((count, 1, 1, 1), 0.03, 0.7) * self._uniform((count, 3, 1, 1), 0.8, 1.2)
        factor = 1 - shape * (1 - dark)
        lights = self._some(count, 0.35)
        factor[:, lights] = 1 / factor[:, lights]
        return colors * factor

    def _switched(self, colors: Tensor, side: Tensor, alpha: Tensor) -> Tensor:
        """Return the frames with lights, screens and windows that switch, each by itself, and stay so for a while: from
        one area to a wall of them, in part of each sample. None of these changes continues."""
        _, count, _, height, width = colors.shape
        cells = 2 ** int(torch.randint(0, 5, (), generator=self.generator))
        levels = self._uniform((4, count, 1, cells, cells), -1.0, 1.0)
        often = self._uniform((count, 1, 1, 1), 0.15, 0.9)  # how often a cell switches in an interval
        for time, since, share in ((1, 3, 1.0), (0, 1, 1.0), (2, 0, alpha.view(-1, 1, 1, 1))):  # in order of time
            stays = torch.rand(levels.shape[1:], generator=self.generator) >= often * share
            levels[time] = torch.where(stays, levels[since], levels[time])
        mode = "nearest" if self._chance() < 0.7 else "bilinear"
        shape = functional.interpolate(levels.flatten(0, 1), (height, width), mode=mode).view(
            4, count, 1, height, width
        )
        where = torch.randn((count, 1, 4, 4), generator=self.generator) + self._uniform((count, 1, 1, 1), -0.5, 2.0)
        where = functional.interpolate(where, (height, width), mode="bicubic", align_corners=False)
        used = torch.sigmoid(8 * where) * (side[:, 1:] <= DYNAMIC)
        return colors * torch.exp2(used * shape * self._uniform((count, 3, 1, 1), 0.2, 2.0))

    def _reflected(self, colors: Tensor, side: Tensor, alpha: Tensor) -> Tensor:
        """Return the frames with another sample as a reflection on part of each."""
        _, count, _, height, width = colors.shape
        strength = self._uniform((count, 1, 1, 1), 0.05, 0.6)
        where = torch.randn((count, 1, 5, 5), generator=self.generator)
        where = functional.interpolate(where, (height, width), mode="bicubic", align_corners=False)
        used = strength * torch.sigmoid(6 * where) * (side[:, 1:] <= DYNAMIC)
        order = torch.randperm(count, generator=self.generator)
        times, strength = self._course(count, alpha)
        used = used * strength.view(4, -1, 1, 1, 1)
        return colors + used * self._moved(colors[2][order], 0.75 * self._grids(times, height, width))


def _earlier(batch: Batch) -> Tensor:
    """Return the frame before the warped previous one, as far as it is known: linear color, at the batch's
    resolution."""
    change = functional.interpolate(batch.trends[:, 7:8], batch.gae.shape[-2:], mode="bilinear", align_corners=False)
    return decode(encode(batch.previous) - change)


def _changes(colors: Tensor, halved: bool) -> Tensor:
    """Return (N, 6, h, w): change of encoded color at half resolution over the last interval, and over the one
    before."""
    now, previous, earlier = (encode(colors[k]) for k in (0, 1, 3))
    changes = torch.cat((now - previous, previous - earlier), 1)
    return changes if halved else halve(changes)


def low_pass(changes: Tensor, known: Tensor, heights: Tensor | None = None) -> Tensor:
    """Return means of `changes` (N, C, h, w; half resolution), where they are `known` (N, 1, h, w), over cells of 8×8
    pixels of the frame, at a quarter of the resolution as in kernels/shading_trend.cl. With `heights` (N,) of the
    frames in pixels, cells around are part of the means."""
    size = [-(-side // 2) for side in changes.shape[-2:]]
    cells = functional.avg_pool2d(torch.cat((changes * known, known), 1), _CELL // 2, ceil_mode=True)
    if heights is not None:
        spacing = torch.tensor([spacing_of(int(height)) for height in heights.tolist()]).view(-1, 1, 1, 1)
        across, along = (torch.arange(side) for side in cells.shape[-2:])
        apart = [(x[:, None] - x[None]).abs() for x in (across, along)]
        weights = [(3 - d / spacing).clamp(min=0) / 9 * (d % spacing == 0) for d in apart]
        cells = weights[0] @ cells @ weights[1]
    mean = cells[:, :-1] / cells[:, -1:].clamp(min=_LEAST_SHARE)
    scaled = functional.interpolate(mean, scale_factor=_CELL // 4, mode="bilinear", align_corners=False)
    return scaled[..., : size[0], : size[1]]
