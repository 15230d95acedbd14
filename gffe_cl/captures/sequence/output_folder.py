"""Output folder of a sequence: rules for files that may be replaced.

Files are written into the folder `gffe-unfinished` within it and moved to their places when all of them are whole:
until then an earlier output stays unchanged. A journal in there is locked while a run is writing; the lock ends with
its process, however that ends. The next run removes files that a killed process left.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from pathlib import Path
from typing import TextIO

from gffe_cl.captures.sequence.description import FILE_NAME, check_file_name
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import lock, open_regular, read_bounded

GENERATOR = "gffe-cl"
STAGING = "gffe-unfinished"
_JOURNAL = ".journal"  # in STAGING: the process, then the names of own files, each a line of JSON
_MOST_JOURNAL = 1 << 20  # bytes
_TRIES = 20  # at entering a folder that another run is just leaving


def refuse_same_folder(output, source) -> None:
    """Raise GffeError if `output` and `source`, folders or their `sequence.json`, are the same folder, or if writing to
    the one would remove the other."""
    output_folder, folder = (os.path.realpath(_folder_of(path)) for path in (output, source))
    if folder == output_folder or Path(folder).is_relative_to(os.path.join(output_folder, STAGING)):
        raise GffeError(f"{output}: the output would overwrite its input (expected another folder)")


def why_unfinished(folder: Path) -> str | None:
    """Return a sentence if `folder` has no `sequence.json` because it is still being written or was never finished,
    else None."""
    journal = folder / STAGING / _JOURNAL
    with contextlib.suppress(OSError), open_regular(journal) as file:
        if not lock(file, shared=True):
            return f"is still being written, {_writer(journal)} (expected to wait for its end)"
        return f"is unfinished: its writer was stopped (expected {FILE_NAME}: write it again)"
    return None


class OutputFolder:
    """Takes possession of `path` in `open` (GffeError if it cannot), ends in `keep` or `discard`."""

    def __init__(self, path: Path, generator: str = GENERATOR):
        self.path, self.generator = path, generator
        self.staging = path / STAGING
        self._journal: TextIO | None = None
        self._own: set[str] = set()  # left by an earlier run, may be replaced
        self._claimed: set[str] = set()
        self._made_folders: list[Path] = []
        self._moving = False

    def open(self) -> None:
        """Create the folder, or take over the one that holds an earlier output."""
        if self.path.exists() and not self.path.is_dir():
            raise GffeError(f"{self.path}: is a file (expected a folder to write a sequence into)")
        try:
            self._journal = self._enter()
            self._own = self._earlier_output()
            self._clear_staging()
            self._journal.truncate(0)
            self._note([os.getpid()])
            (self.staging / FILE_NAME).unlink(missing_ok=True)
        except (OSError, GffeError) as error:
            self._leave()
            if isinstance(error, GffeError):
                raise
            raise GffeError(
                f"{self.path}: cannot be written to ({error.strerror or error}; expected a writable folder)"
            ) from None

    def claim(self, name: str) -> Path:
        """Return the path to write file `name` to. Raises GffeError if that would overwrite a file of another
        origin."""
        check_file_name(name, str(self.path))
        path = self.path / name
        if name in self._claimed:
            raise GffeError(f"{path}: is written twice (expected a different file for each frame)")
        if Path(name).parts[0] in (STAGING, _JOURNAL) or not self._is_inside(path):
            raise GffeError(f"{path}: cannot be written there (expected another folder)")
        if os.path.isdir(path) or (name not in self._own and os.path.lexists(path)):
            raise GffeError(f"{path}: exists and was not written by gffe-cl (expected an empty folder)")
        self._claimed.add(name)
        return self._place(name)

    def folder(self, name: str) -> Path:
        """Return the folder for files that are not frames and go into the folder `name` with them."""
        return self._place(f"{name}/any").parent

    def keep(self, document: str, files: list[str], interrupted: bool) -> Path:
        """Finish the output, and return the folder of the sequence. Own files are replaced or removed, and
        `sequence.json` with the text `document` appears at once.

        If the run was `interrupted` and found an earlier output, that stays unchanged, and the new frames stay beside
        it.
        """
        path = self.path / FILE_NAME
        try:
            with open(self.staging / FILE_NAME, "w", encoding="utf-8") as file:
                file.write(document)
                file.flush()
                os.fsync(file.fileno())
            if interrupted and path.exists():
                self._release()
                return self.staging
            self._move(files)
        except OSError as error:
            raise GffeError(f"{path}: cannot be written ({error.strerror or error})") from None
        self._remove(self._own - set(files))
        self._clear_staging()
        self._leave()
        return self.path

    def discard(self) -> None:
        """Remove the files of this run and the folders made for them. Earlier output stays."""
        if self._moving:  # too late: the folder has files of both, and the next run removes them
            self._release()
            return
        self._clear_staging()
        self._leave()
        for folder in reversed(self._made_folders):
            with contextlib.suppress(OSError):
                folder.rmdir()

    def _move(self, files: list[str]) -> None:
        moves = [path for path in self._staged() if path not in (Path(_JOURNAL), Path(FILE_NAME))]
        for name in moves:
            (self.path / name).parent.mkdir(parents=True, exist_ok=True)
        os.fsync(self._note(sorted({*self._own, *files})).fileno())
        self._moving = True
        (self.path / FILE_NAME).unlink(missing_ok=True)
        for name in moves:
            os.replace(self.staging / name, self.path / name)
        os.replace(self.staging / FILE_NAME, self.path / FILE_NAME)
        self._moving = False

    def _staged(self) -> list[Path]:
        found = [Path(folder) / file for folder, _, files in os.walk(self.staging) for file in files]
        return [path.relative_to(self.staging) for path in found]

    # ---- one run at a time -----------------------------------------------------------------------------

    def _enter(self) -> TextIO:
        """Return the journal, locked. Raises GffeError if another run is writing into the folder."""
        journal = self.staging / _JOURNAL
        for _ in range(_TRIES):
            self._make_folder(self.path)
            with contextlib.suppress(FileExistsError):
                self.staging.mkdir()
            try:
                there = os.listdir(self.staging)  # the journal comes first and goes last
                if self.staging.is_symlink() or (there and _JOURNAL not in there):
                    raise GffeError(f"{self.staging}: exists and was not written by gffe-cl (expected another folder)")
                file = open(journal, "a+", encoding="utf-8", errors="replace")  # noqa: SIM115
            except FileNotFoundError:
                continue
            if not lock(file):
                file.close()
                raise GffeError(f"{self.path}: another run is writing into it, {_writer(journal)} (expected its end)")
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), os.stat(journal)):
                    return file
            file.close()
        raise GffeError(f"{self.path}: other runs keep writing into it (expected another folder)")

    def _leave(self) -> None:
        """Release the lock and remove its file."""
        if self._journal is not None:
            with contextlib.suppress(OSError):
                (self.staging / _JOURNAL).unlink()
            with contextlib.suppress(OSError):
                self.staging.rmdir()
        self._release()

    def _release(self) -> None:
        if self._journal is not None:
            with contextlib.suppress(OSError):  # what a full disk did not take was told of before
                self._journal.close()
            self._journal = None

    def _note(self, values: list) -> TextIO:
        journal = self._open_journal()
        journal.writelines(json.dumps(value) + "\n" for value in values)
        journal.flush()
        return journal

    def _open_journal(self) -> TextIO:
        assert self._journal is not None  # from `__init__` to the end of the output
        return self._journal

    # ---- files -----------------------------------------------------------------------------------------

    def _earlier_output(self) -> set[str]:
        journal = self._open_journal()
        journal.seek(0)
        names: list = []
        with contextlib.suppress(ValueError):  # the process ended within a line
            for line in journal.read().splitlines()[1:]:
                names.append(json.loads(line))
        json_path = self.path / FILE_NAME
        if json_path.exists():
            try:
                with open_regular(json_path) as file:
                    document = json.loads(file.read())
                ours = document["generator"] == self.generator
                names += [frame["file"] for frame in document["frames"]]
            except (OSError, ValueError, KeyError, TypeError, RecursionError):
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

    def _place(self, name: str) -> Path:
        path = self.staging / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GffeError(f"{path}: cannot be written ({error.strerror or error})") from None
        return path

    def _clear_staging(self) -> None:
        if self._journal is None:
            return
        for path in self.staging.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != _JOURNAL:
                with contextlib.suppress(OSError):
                    path.unlink()

    def _remove(self, names) -> None:
        for name in names:
            path = self.path / name
            if self._is_inside(path):
                with contextlib.suppress(OSError):
                    path.unlink()

    def _is_inside(self, path: Path) -> bool:
        """Return whether no link leads out of the folder."""
        return Path(os.path.realpath(path.parent)).is_relative_to(os.path.realpath(self.path))

    def _make_folder(self, path: Path) -> None:
        missing = []
        while not path.is_dir():
            missing.append(path)
            path = path.parent
        for folder in reversed(missing):
            with contextlib.suppress(FileExistsError):
                folder.mkdir()
                self._made_folders.append(folder)


def _folder_of(path) -> Path:
    return Path(path).parent if Path(path).name == FILE_NAME else Path(path)


def _writer(journal: Path) -> str:
    with contextlib.suppress(OSError, UnicodeError):
        lines = read_bounded(journal, _MOST_JOURNAL).decode("utf-8").splitlines()
        if lines and lines[0].isdigit():
            return f"process {lines[0]}"
    return "another process"
