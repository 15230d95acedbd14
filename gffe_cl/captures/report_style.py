"""Style of reports: the CSS that all of them share, and the colors of errors."""

from importlib.resources import files

import numpy as np


def report_style() -> str:
    """Return the CSS for light and dark, narrow and wide pages, and for print."""
    return files("gffe_cl.captures").joinpath("report.css").read_text("utf-8")


def heat(values: np.ndarray) -> np.ndarray:
    """Return colors (…, 3) of `values` from 0 to 1, on a black–red–yellow–white scale."""
    return np.clip(np.stack([3 * values, 3 * values - 1, 3 * values - 2], -1), 0, 1)
