"""Reader of images in HDF5 files, which Spring uses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.captures.formats.images import Size
from gffe_cl.engine.core.errors import GffeError, require_packages
from gffe_cl.engine.core.files import require_moderate, require_readable


def read_hdf5(path: Path, name: str, size: Size, components: int, follow_links: bool) -> np.ndarray:
    """Return the data set `name` of the HDF5 file at `path`: (H, W, components) float32; it may have twice as many
    pixels as `size` each way. Raises GffeError, also without h5py, and unless `follow_links` where the data lie in
    another file."""
    require_packages("a file of Spring", "spring", "h5py")
    import h5py

    label = path.name
    require_readable(path, label)
    try:
        with h5py.File(path, "r") as file:
            _check_link(file.get(name, getlink=True), path, name, follow_links)
            # Names of external storage are relative to the folder of the file, not to the working directory.
            access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
            access.set_efile_prefix(b"${ORIGIN}")
            stored = h5py.Dataset(h5py.h5d.open(file.id, name.encode(), access))
            _check_storage(stored, path, name, follow_links)
            factor = _factor(stored, size, components, label)
            held = [math.prod(shape) * stored.dtype.itemsize for shape in (stored.shape, stored.chunks or ())]
            require_moderate(max(held), math.prod(size), label)  # a chunk is decoded as a whole
            array = stored[::factor, ::factor].astype(np.float32)
    except GffeError:
        raise
    except Exception as error:  # whatever the library meets in a damaged file
        raise GffeError(f"{label}: cannot be read ({' '.join(str(error).split())[:200]})") from None
    return array.reshape(size[1], size[0], components)


def _check_link(link: Any, path: Path, name: str, follow_links: bool) -> None:
    """Raise GffeError if a link in an HDF5 file is not allowed. `link`: how the file refers to `name`."""
    import h5py

    if isinstance(link, h5py.HardLink | None):
        return
    _require_allowed(path, name, "a link", follow_links)
    if isinstance(link, h5py.ExternalLink):
        require_readable(path.parent / link.filename, path.name)


def _check_storage(stored: Any, path: Path, name: str, follow_links: bool) -> None:
    elsewhere = [one[0] for one in stored.external or ()]
    if stored.is_virtual:
        elsewhere += [one.file_name for one in stored.virtual_sources() if one.file_name != "."]
    if elsewhere:
        _require_allowed(path, name, f"in another file, '{elsewhere[0]}'", follow_links)
    for file in (one for one in elsewhere if "%" not in one):  # with it: several, by number
        require_readable(path.parent / file, path.name)


def _require_allowed(path: Path, name: str, what: str, follow_links: bool) -> None:
    if not follow_links:
        raise GffeError(f"{path.name}: {name} is {what} (expected the data in this file; --follow-links allows it)")


def _factor(stored: Any, size: Size, components: int, label: str) -> int:
    """Return how many pixels of the data set are one of `size`, each way."""
    shape, plain = stored.shape, ((), (1,)) if components == 1 else ((components,),)
    for factor in (1, 2):
        if shape is not None and shape[:2] == (factor * size[1], factor * size[0]) and shape[2:] in plain:
            if stored.dtype.kind != "f":
                raise GffeError(f"{label}: numbers of type {stored.dtype} (expected floating-point numbers)")
            return factor
    given = "no data" if shape is None else f"data of shape {shape}"
    numbers = "a number" if components == 1 else f"{components} numbers"
    raise GffeError(f"{label}: {given}, expected {size[0]}×{size[1]} pixels of {numbers}, or twice that each way")
