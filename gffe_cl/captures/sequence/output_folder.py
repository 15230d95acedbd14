"""Output folder of a sequence: files are written into `OUT.part` and take their places when all are whole."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
from pathlib import Path

from gffe_cl.captures.sequence.description import FILE_NAME, FORMAT, check_file_name
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import open_regular, write_text

GENERATOR = "gffe-cl"
PART, _EARLIER = ".part", ".earlier"


def refuse_same_folder(output, source) -> None:
    """Raise GffeError if `output` and `source`, folders or their `sequence.json`, are the same folder, if writing to
    the one would remove the other, or if `output` is inside `source`."""
    output_folder, folder = (Path(os.path.realpath(_folder_of(path))) for path in (output, source))
    if folder in (output_folder, _beside(output_folder, PART)):
        raise GffeError(f"{output}: the output would overwrite its input (expected another folder)")
    if folder in output_folder.parents:
        raise GffeError(f"{output}: the output would be inside its input {source} (expected another folder)")


def why_unfinished(folder: Path) -> str | None:
    """Return a sentence if `folder` has no `sequence.json` because it is still being written or was never finished,
    else None."""
    part = _beside(Path(os.path.realpath(folder)), PART)
    if (folder / FILE_NAME).exists() or not (part / FILE_NAME).exists():
        return None
    return f"is unfinished: its writer is at work or was stopped, its frames are in {part} (expected {FILE_NAME})"


class OutputFolder:
    """Takes possession of `path` in `open` (GffeError if it cannot), ends in `keep` or `discard`."""

    def __init__(self, path: Path, generator: str = GENERATOR):
        self.path, self.generator = path, generator
        self._target = Path(os.path.realpath(path))
        self.staging = _beside(self._target, PART)
        self._own: set[str] = set()  # of an earlier run, may be replaced
        self._claimed: set[str] = set()
        self._made_folders: list[Path] = []

    def open(self, settings: str | None = None) -> str | None:
        """Create the folder to write into, or clear that of a run that was stopped. If it was of the same `settings`,
        its files stay, and the text of its `sequence.json` is returned."""
        if os.path.lexists(self.path) and not self.path.is_dir():
            raise GffeError(f"{self.path}: is a file (expected a folder to write a sequence into)")
        stub = {"format": FORMAT, "generator": self.generator, "unfinished": True, "settings": settings, "frames": []}
        try:
            self._own = self._earlier_output(self._target)
            if self._target.exists() and not os.access(self._target, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            if os.path.lexists(self.staging):
                if not (self.staging / FILE_NAME).exists() or self.staging.is_symlink():
                    raise GffeError(f"{self.staging}: was not written by {self.generator} (expected another folder)")
                self._earlier_output(self.staging)
                kept = (self.staging / FILE_NAME).read_text("utf-8")
                if settings is not None and json.loads(kept).get("settings") == settings:
                    return kept
                shutil.rmtree(self.staging)
            self._make_folder(self.staging)
            (self.staging / FILE_NAME).write_text(json.dumps(stub))
        except OSError as error:
            raise GffeError(
                f"{self.path}: cannot be written to ({error.strerror or error}; expected a writable folder)"
            ) from None
        return None

    def claim(self, name: str) -> Path:
        """Return the path to write file `name` to. Raises GffeError if that would overwrite a file of another
        origin."""
        check_file_name(name, str(self.path))
        path, place = self.path / name, self._target / name
        if name in self._claimed:
            raise GffeError(f"{path}: is written twice (expected a different file for each frame)")
        folders = list(place.parents)[: len(Path(name).parts) - 1]
        if any(os.path.lexists(one) and (one.is_symlink() or not one.is_dir()) for one in folders):
            raise GffeError(f"{path}: cannot be written there (expected another folder)")
        if os.path.isdir(place) or (name not in self._own and os.path.lexists(place)):
            raise GffeError(f"{path}: exists and was not written by gffe-cl (expected an empty folder)")
        self._claimed.add(name)
        return self._place(name)

    def has(self, name: str) -> bool:
        """Return whether the file `name` of this run, or of the one that is continued, is written."""
        return (self.staging / name).is_file()

    def folder(self, name: str) -> Path:
        """Return the folder for files that are not frames and go into the folder `name` with them."""
        return self._place(f"{name}/any").parent

    def note(self, document: str) -> None:
        """Write the text `document` of `sequence.json` with the frames that are finished so far. Raises OSError."""
        write_text(self.staging / FILE_NAME, document)

    def keep(self, document: str, interrupted: bool) -> Path:
        """Finish the output with the text `document` of `sequence.json`, and return the folder of the sequence. Files
        of an earlier output are removed, files of others move along. After an `interrupted` run an earlier output
        stays, and the new frames stay beside it."""
        path = self.path / FILE_NAME
        try:
            with open(self.staging / FILE_NAME, "w", encoding="utf-8") as file:
                file.write(document)
                file.flush()
                os.fsync(file.fileno())
            if interrupted:
                return self.staging
            self._replace()
        except OSError as error:
            raise GffeError(f"{path}: cannot be written ({error.strerror or error})") from None
        return self.path

    def discard(self) -> None:
        """Remove the files of this run and the folders made for them. Earlier output stays."""
        shutil.rmtree(self.staging, ignore_errors=True)
        for folder in reversed(self._made_folders):
            with contextlib.suppress(OSError):
                folder.rmdir()

    def _replace(self) -> None:
        """Give the new files the places of the earlier ones. The folder itself, which may be the current one, and files
        that no earlier run wrote stay. Where that fails, the earlier output is put back."""
        if not self._target.exists():
            os.rename(self.staging, self._target)
            return
        earlier = self.staging / _EARLIER
        new = [path for path in sorted(self.staging.rglob("*")) if path.is_symlink() or not path.is_dir()]
        names = [str(path.relative_to(self.staging)) for path in new if path.name != FILE_NAME] + [FILE_NAME]
        moved: list[tuple[Path, Path]] = []  # from, to

        def move(source: Path, place: Path) -> None:
            place.parent.mkdir(parents=True, exist_ok=True)
            os.rename(source, place)
            moved.append((source, place))

        try:
            for name in (FILE_NAME, *sorted(self._own - {FILE_NAME})):  # without it, it is no sequence
                if os.path.lexists(self._target / name):
                    move(self._target / name, earlier / name)
            for name in names:
                move(self.staging / name, self._target / name)
        except OSError:
            for source, place in reversed(moved):
                os.rename(place, source)
            raise
        for name in self._own:
            with contextlib.suppress(OSError):
                (self._target / name).parent.rmdir()  # if nothing is left in it
        shutil.rmtree(self.staging, ignore_errors=True)

    # ---- files -----------------------------------------------------------------------------------------

    def _earlier_output(self, folder: Path) -> set[str]:
        """Return the files that the `sequence.json` of a folder names. Raises GffeError if another program wrote it."""
        json_path = folder / FILE_NAME
        if not json_path.exists():
            return set()
        own = {FILE_NAME}
        try:
            with open_regular(json_path) as file:
                document = json.loads(file.read())
            ours = document["generator"] == self.generator
            for frame in document["frames"]:
                with contextlib.suppress(GffeError):
                    own.add(check_file_name(frame["file"], "earlier output"))
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            ours = False
        if not ours:
            raise GffeError(f"{json_path}: was not written by {self.generator}, so it stays (expected another folder)")
        return own

    def _place(self, name: str) -> Path:
        path = self.staging / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GffeError(f"{path}: cannot be written ({error.strerror or error})") from None
        return path

    def _make_folder(self, path: Path) -> None:
        missing = []
        while not path.is_dir():
            missing.append(path)
            path = path.parent
        for folder in reversed(missing):
            folder.mkdir()
            self._made_folders.append(folder)


def _beside(folder: Path, ending: str) -> Path:
    return folder.with_name(folder.name + ending)


def _folder_of(path) -> Path:
    return Path(path).parent if Path(path).name == FILE_NAME else Path(path)
