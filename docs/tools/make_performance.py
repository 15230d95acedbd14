"""Writes the tables of docs/performance.md and the times in the README, from docs/measured/.

python docs/tools/make_performance.py
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable

from pages import DOCS, REPOSITORY, recorded, table, with_all

PAGE, README = DOCS / "performance.md", REPOSITORY / "README.md"


_FAST = "GAE, preset `performance`"


def gpu_table() -> str:
    """Return milliseconds on a GPU by part: of the default, and sums of the preset performance."""
    default, performance = (recorded(name)["devices"][0]["sizes"] for name in ("gpu", "gpu_performance"))
    parts = [part for part in default[0]["milliseconds"] if part not in ("GAE", "SCN", "misc")]
    rows = [(part, *(f"{one['milliseconds'][part]:.2f}" for one in default)) for part in parts]
    for label, part, sizes in (("GAE", "GAE", default), ("SCN", "SCN", default), (_FAST, "GAE", performance)):
        rows.append((f"**{label}**", *(f"**{one['milliseconds'][part]:.2f}**" for one in sizes)))
    for label, sizes in (("wall time of a default pair", default), ("wall time, preset `performance`", performance)):
        rows.append((label, *(f"{one['wall']:.2f}" for one in sizes)))
    columns = ("ms", *(f"{one['width']}×{one['height']}" for one in default))
    return f"Commit {recorded('gpu')['commit']}:\n\n" + table(columns, rows)


def times_text() -> str:
    """Return the times of a frame of 1920×1080, for the README."""
    default, fast = (recorded(name)["devices"][0]["sizes"][0] for name in ("gpu", "gpu_performance"))
    gae, scn = (default["milliseconds"][part] for part in ("GAE", "SCN"))
    wall, preset, commit = default["wall"], fast["milliseconds"]["GAE"], recorded("gpu")["commit"]
    text = (
        f"**Time of a 1080p frame**: on an NVIDIA H100 {gae + scn:.2f} ms of kernels with the network"
        f" ({wall:.2f} ms by wall time), {gae:.2f} ms without it, and {preset:.2f} ms with `--preset performance`"
        f" ([by stage](docs/performance.md#gpus-measured); commit {commit}). `gffe bench --device gpu`"
        " measures yours."
    )
    return textwrap.fill(text, 158, break_on_hyphens=False)


TABLES: dict[str, Callable[[], str]] = {
    "gpu": gpu_table,
}


def with_tables(text: str) -> str:
    """Return the page with all its tables as the records have them now."""
    return with_all(text, {name: make() for name, make in TABLES.items()})


def with_times(text: str) -> str:
    """Return the README with the times as the records have them now."""
    return with_all(text, {"times": times_text()})


def main() -> None:
    PAGE.write_text(with_tables(PAGE.read_text()))
    README.write_text(with_times(README.read_text()))


if __name__ == "__main__":
    main()
