"""Pages of the documentation and records of measurements: where they are, and tables in the pages.

    python docs/tools/pages.py --check     lists the records that are older than the kernels; exit code 1 if any are

In Markdown, `<!-- NAME:begin -->` and `<!-- NAME:end -->` mark where the table NAME stands.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
MEASURED, PICTURES = DOCS / "measured", DOCS / "pictures"
_MEASURED_CODE = "kernels/*.cl", "kernels/*.h", ":!kernels/scenes", ":!kernels/baselines", "gffe_cl/engine/stages"


def recorded(name: str) -> dict[str, Any]:
    """Return the record of that name in docs/measured/."""
    return json.loads((MEASURED / f"{name}.json").read_text("utf-8"))


def write_record(name: str, document: Mapping[str, Any]) -> None:
    """Write `document` as NAME.json in docs/measured, with the commit and the command that made it."""
    command = " ".join(["python", *(f'"{word}"' if " " in word else word for word in sys.argv)])
    commit = _git("rev-parse", "--short", "HEAD").strip()
    commit += "-dirty" if _git("status", "--porcelain", "--", "kernels", "gffe_cl") else ""
    known = {"commit": commit, "command": command, **document}
    text = json.dumps(known, indent=1, ensure_ascii=False)
    text = re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), text)  # lists of numbers on one line
    (MEASURED / f"{name}.json").write_text(text + "\n", "utf-8")


def stale_records() -> Iterator[str]:
    """Yield a sentence for each record in docs/measured/ that is older than the kernels or the stages."""
    for path in sorted(MEASURED.glob("*.json")):
        commit = recorded(path.stem)["commit"].removesuffix("-dirty")
        try:
            later = _git("log", "--format=%h", f"{commit}..HEAD", "--", *_MEASURED_CODE).split()
        except subprocess.CalledProcessError:
            yield f"{path.name}: commit {commit} is not in this clone"
            continue
        if later:
            yield f"{path.name}: {len(later)} commits to kernels and stages since {commit}"


def checkout(commit: str, folder: Path, *names: str) -> None:
    """Put the files of a commit, or only those under `names`, into a folder. Exits with code 2 if there is no such
    commit."""
    archive = subprocess.run(["git", "-C", REPOSITORY, "archive", commit, *names], capture_output=True)
    if archive.returncode:
        print(f"error: {commit}: neither a folder nor a commit: {archive.stderr.decode().strip()}", file=sys.stderr)
        sys.exit(2)
    subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)


def _git(*words: str) -> str:
    return subprocess.run(["git", "-C", REPOSITORY, *words], check=True, capture_output=True, text=True).stdout


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    heads = tuple(heads)
    lines = [heads, ("---",) * len(heads), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def between_markers(text: str, name: str, made: str) -> str:
    """Return `text` with `made` between the markers of `name`; unchanged where it has none."""
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    if begin not in text:
        return text
    before, _, rest = text.partition(begin)
    _, _, after = rest.partition(end)
    return f"{before}{begin}\n{made}\n{end}{after}"


def with_all(text: str, tables: Mapping[str, str]) -> str:
    """Return `text` with all of `tables`, by name, between their markers."""
    for name, made in tables.items():
        text = between_markers(text, name, made)
    return text


def write_tables(page: str, tables: Mapping[str, str]) -> None:
    """Write `tables`, by name, into a page of docs/."""
    path = DOCS / page
    path.write_text(with_all(path.read_text("utf-8"), tables), "utf-8")


if __name__ == "__main__" and sys.argv[1:] == ["--check"]:
    stale = list(stale_records())
    print("\n".join(stale or ["no record is older than the kernels"]))
    sys.exit(bool(stale))
