"""Writer of the exported folder."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import made_folder
from gffe_cl.engine.export.recording import record
from gffe_cl.engine.export.tables import Tables, config
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import expand
from gffe_cl.engine.options import Options

KERNELS = "kernels"
MARK = "gffe_config.h"  # a folder that has it was made here


def export(folder: Path, device: Device, options: Options) -> list[str]:
    """Write the pipeline of `options` as C into a folder: new, empty, or written by an export before.

    `device` is only needed to make the stages; the files suit every device. The options are fixed then, sizes are not.
    Returns the names of the files written. Raises GffeError for options that cannot be exported, and for folders that
    cannot be written or hold something else.
    """
    tables = Tables((record(device, options, False), record(device, options, True)))
    texts = {path.name: path.read_text("utf-8") for path in _templates()}
    texts |= {"gffe_tables.c": tables.text(), MARK: config(options, tables.plans[0].operations)}
    texts |= {f"{KERNELS}/{name}.cl": expand(f"{name}.cl") for name in tables.programs}
    _require_own(folder)
    try:
        with made_folder(folder), TemporaryDirectory(prefix=".gffe-export-", dir=folder) as name:
            part = Path(name)
            (part / KERNELS).mkdir()
            for name, text in texts.items():
                (part / name).write_text(text, "utf-8")
            _replace(folder, part)
    except OSError as error:
        raise GffeError(f"{error.filename or folder}: cannot write: {error.strerror or error}") from None
    return sorted(texts)


def _templates() -> list[Path]:
    folder = Path(str(files("gffe_cl.engine.export") / "c"))
    return sorted(path for path in folder.iterdir() if path.is_file())


def _replace(folder: Path, part: Path) -> None:
    """Move the contents of `part` into `folder`, in place of an earlier export's files."""
    for old in (*folder.glob("gffe*.[ch]"), *(folder / KERNELS).glob("*.cl")):
        old.unlink()
    (folder / KERNELS).mkdir(exist_ok=True)
    for path in sorted(path for path in part.rglob("*") if path.is_file()):
        os.replace(path, folder / path.relative_to(part))


def _require_own(folder: Path) -> None:
    """Raise GffeError if the folder holds anything but an export."""
    if folder.exists() and not folder.is_dir():
        raise GffeError(f"{folder}: is a file (expected a folder, new or empty)")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / MARK).is_file():
        raise GffeError(f"{folder}: is not empty, and not written by `gffe export` (expected a new or an empty folder)")
