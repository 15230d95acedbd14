"""Metrics of images, flicker, and the regions in which errors are counted. The viewer uses nothing else of the lab."""

from gffe_cl.lab.metrics.images import (
    FOCUS,
    METRICS,
    Metric,
    RegionErrors,
    decibels,
    flip_error,
    focus_mask,
    measurable,
    missing_metrics,
    psnr,
    relative_error,
    shading_regions,
    smape,
    squared_error,
    ssim,
    to_display,
)

__all__ = [
    "FOCUS",
    "METRICS",
    "Metric",
    "RegionErrors",
    "decibels",
    "flip_error",
    "focus_mask",
    "measurable",
    "missing_metrics",
    "psnr",
    "relative_error",
    "shading_regions",
    "smape",
    "squared_error",
    "ssim",
    "to_display",
]
