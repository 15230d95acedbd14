"""The folder that a sequence is written into: what may be replaced in it, what must go when writing fails.

While a sequence is being written, the folder holds a journal with the names of the files that are gffe-cl's
own: a later run may replace those, and nothing else, even after this one was killed.
"""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path

from gffe_cl.errors import GffeError
from gffe_cl.sequence.description import FILE_NAME, check_file_name

GENERATOR = "gffe-cl"
_JOURNAL = ".gffe-unfinished"


def refuse_same_folder(output, source) -> None:
    """GffeError if `output` and `source`, folders or their `sequence.json`, are the same folder."""
    folders = [Path(p).parent if Path(p).name == FILE_NAME else Path(p) for p in (output, source)]
    if os.path.realpath(folders[0]) == os.path.realpath(folders[1]):
        raise GffeError(f"{output}: the output would overwrite its input (expected another folder)")


class OutputFolder:
    """Takes possession of `path` in `open` (GffeError if it cannot), ends in `keep` or `discard`."""

    def __init__(self, path: Path, generator: str = GENERATOR):
        self.path, self.generator = path, generator
        self._own: set[str] = set()  # left by an earlier run, may be replaced
        self._claimed: set[str] = set()
        self._made_folders: list[Path] = []

    def open(self) -> None:
        """Create the folder, or take over the one that holds an earlier output."""
        if self.path.exists() and not self.path.is_dir():
            raise GffeError(f"{self.path}: is a file (expected a folder to write a sequence into)")
        try:
            self._make_folder(self.path)
            self._own = self._earlier_output()
            (self.path / _JOURNAL).write_text("".join(name + "\n" for name in sorted(self._own)), "utf-8")
            (self.path / FILE_NAME).unlink(missing_ok=True)
        except OSError as error:
            self._remove_made_folders()
            raise GffeError(
                f"{self.path}: cannot be written to ({error.strerror or error}; expected a writable folder)"
            ) from None

    def claim(self, name: str) -> Path:
        """The path to write file `name` to; GffeError if that would overwrite somebody else's file."""
        check_file_name(name, str(self.path))
        path = self.path / name
        if name in self._claimed:
            raise GffeError(f"{path}: is written twice (expected a file of its own for each frame)")
        if name not in self._own and os.path.lexists(path):
            raise GffeError(f"{path}: exists and was not written by gffe-cl (expected an empty folder)")
        try:
            self._make_folder(path.parent)
            with open(self.path / _JOURNAL, "a", encoding="utf-8") as journal:
                journal.write(name + "\n")
        except OSError as error:
            raise GffeError(f"{path}: cannot be written ({error.strerror or error})") from None
        self._claimed.add(name)
        return path

    def keep(self, document: str, files: list[str]) -> None:
        """Finish: `sequence.json` appears at once with the text `document`; own files not in `files` go."""
        path = self.path / FILE_NAME
        part_path = self.path / f".{FILE_NAME}.part"
        try:
            with open(part_path, "w", encoding="utf-8") as file:
                file.write(document)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part_path, path)
        except OSError as error:
            raise GffeError(f"{path}: cannot be written ({error.strerror or error})") from None
        finally:
            with contextlib.suppress(OSError):
                part_path.unlink()
        self._remove((self._own | self._claimed) - set(files))
        self._remove({_JOURNAL})

    def discard(self) -> None:
        """Remove every file of this and the earlier output, and the folders made for them."""
        self._remove(self._own | self._claimed | {FILE_NAME, _JOURNAL})
        self._remove_made_folders()

    def _earlier_output(self) -> set[str]:
        names: list = []
        with contextlib.suppress(FileNotFoundError):
            names += (self.path / _JOURNAL).read_text("utf-8", "replace").splitlines()
        json_path = self.path / FILE_NAME
        if json_path.exists():
            try:
                document = json.loads(json_path.read_text("utf-8"))
                ours = document["generator"] == self.generator
                names += [frame["file"] for frame in document["frames"]]
            except (ValueError, KeyError, TypeError):
                ours = False
            if not ours:
                raise GffeError(
                    f"{json_path}: was not written by {self.generator}, so it stays (expected another folder)"
                )
        own = set()
        for name in names:
            with contextlib.suppress(GffeError):
                own.add(check_file_name(name, "earlier output"))
        return own

    def _remove(self, names) -> None:
        """Files only, and only where no link leads out of the folder."""
        root = os.path.realpath(self.path)
        for name in names:
            path = self.path / name
            parent = os.path.realpath(path.parent)
            if parent == root or parent.startswith(root + os.sep):
                with contextlib.suppress(OSError):
                    path.unlink()

    def _make_folder(self, path: Path) -> None:
        missing = []
        while not path.is_dir():
            missing.append(path)
            path = path.parent
        for folder in reversed(missing):
            folder.mkdir()
            self._made_folders.append(folder)

    def _remove_made_folders(self) -> None:
        for folder in reversed(self._made_folders):
            with contextlib.suppress(OSError):
                folder.rmdir()
        self._made_folders.clear()
