"""Operations on images as tensors (N, C, H, W): other resolutions, and sampling along a flow."""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor


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
