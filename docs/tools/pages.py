"""Pages of the documentation: where they are, and tables in them.

In Markdown, `<!-- NAME:begin -->` and `<!-- NAME:end -->` mark where the table NAME stands.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
MEASURED, PICTURES = DOCS / "measured", DOCS / "pictures"


def recorded(name: str) -> dict[str, Any]:
    """Return the record of that name in docs/measured/."""
    return json.loads((MEASURED / f"{name}.json").read_text("utf-8"))


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
