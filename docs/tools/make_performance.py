"""Writes the tables of docs/performance.md, the times in the README and the plot of methods, from docs/measured/.

    python docs/tools/make_performance.py                              the tables, from what is recorded
    python docs/tools/make_performance.py --measure [--sequence DIR]   counts first commands and memory, on plaza,
                                                                       forest and a sequence: the same anywhere

The other records: `gffe bench --traffic --lanes 1,8 --json docs/measured/traffic.json`, and on a quiet machine
`gffe bench --methods --json docs/measured/methods.json`.
"""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

from pages import DOCS, MEASURED, PICTURES, REPOSITORY, recorded, table, with_all
from scatter import Point, scatter

PAGE, README = DOCS / "performance.md", REPOSITORY / "README.md"
LINE = 120  # characters of a line of text
REMAP = "remap-bilinear"  # the simplest method that uses motion vectors
PEER = "dilate-splat"  # the cheapest one with a depth test, on the same runtimes
OURS = ("gffe", "no-scn", "quality", "performance")
BY_REGION = (REMAP, PEER, "no-scn", "gffe")  # columns of the table of regions
SIZE, SCENES = (1920, 1080), ("plaza", "forest")


def memory_table() -> str:
    found = recorded("memory")
    rows = [
        ("commands, GAE", *(str(one["commands"]["GAE"]) for one in found.values())),
        ("device memory, GAE, MiB", *(f"{one['memory_gae'] / 2**20:.0f}" for one in found.values())),
    ]
    return table(("", *(f"`{name}`" for name in found)), rows)


def traffic_table() -> str:
    lanes = recorded("traffic")["lanes"]
    first = next(iter(lanes.values()))
    rows = []
    for name in first:
        counted = (f"{kernels[name]['loaded'] + kernels[name]['stored']:.1f}" for kernels in lanes.values())
        rows.append((f"`{name}`", *counted))
    heads = (f"loaded and stored, {'one pixel' if n == '1' else f'{n} pixels'} a work-item" for n in lanes)
    return table(("bytes per pixel", *heads), rows)


def size_of_traffic() -> str:
    found = recorded("traffic")
    width, height = found["part"]
    whole = "×".join(map(str, found["size"]))
    return f"In {width}×{height} pixels of `{found['of']}`, {whole}, which are much like the rest."


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
    return table(("ms", *(f"{one['width']}×{one['height']}" for one in default)), rows)


def methods_table() -> str:
    rows = []
    for row in _methods():
        times = _milliseconds(row["milliseconds"]), f"{row['ratio']:.2f}", f"{row['psnr']:.2f}"
        rows.append((f"`{row['method']}`", row["title"], _where(row), *times))
    return table(("method", "what it is", "on", "ms", "× `gffe`", "PSNR, dB"), rows)


def regions_table() -> str:
    """Return the table of methods by region: the error of a remap, and that of other methods there."""
    first = {row["method"]: row for row in reversed(_methods())}  # on the first device
    columns = [first[name] for name in BY_REGION if name in first]
    heads = (f"`{row['method']}`, {_milliseconds(row['milliseconds'])} ms" for row in columns)
    rows = []
    for region, share in _shares().items():
        psnr = (f"{row['regions'][region]:.2f}" for row in columns)
        rows.append((region, f"{share:.2%}", f"{_share_of_error(first[REMAP], region):.0%}", *psnr))
    rows.append(("all", "100%", "100%", *(f"{row['psnr']:.2f}" for row in columns)))
    return table(("PSNR, dB", "pixels", f"error of `{REMAP}`", *heads), rows)


def methods_text() -> str:
    """Return the gain of the additional milliseconds, step by step and by region, and where there is none."""
    record, shares = recorded("methods")["sizes"][0], _shares()
    remap, gae, full = (_method(name) for name in (REMAP, "no-scn", "gffe"))
    removed, ahead = [], []
    for region in sorted(shares, key=lambda region: -_share_of_error(remap, region))[:3]:
        left = 10 ** ((remap["regions"][region] - gae["regions"][region]) / 10)
        removed.append(
            f"{_share_of_error(remap, region):.0%} lies in *{region}* ({shares[region]:.1%} of the pixels), where GFFE"
            f" without the network has {left:.0%} of that error"
        )
    for region in shares:
        best = max(_methods(), key=lambda row: row["regions"][region])
        if best["method"] not in OURS:
            figures = f"{best['regions'][region]:.2f} dB, GFFE {full['regions'][region]:.2f} dB"
            ahead.append(f"in *{region}* `{best['method']}` reaches {figures}")
    text = (
        f"On `{record['of'].partition(':')[0]}`, {record['width']}×{record['height']}, `{REMAP}` takes"
        f" {_milliseconds(remap['milliseconds'])} ms and reaches {remap['psnr']:.2f} dB. GFFE without the network takes"
        f" {_milliseconds(gae['milliseconds'])} ms on {_where(gae)} and reaches {gae['psnr']:.2f} dB. The network adds"
        f" {_milliseconds(full['milliseconds'] - gae['milliseconds'])} ms and {full['psnr'] - gae['psnr']:.2f} dB."
        f" Of the squared error of `{REMAP}`, {'; '.join(removed)}."
    )
    for peer in (row for row in _methods() if row["method"] == PEER):
        without = next(r for r in _methods() if r["method"] == "no-scn" and r["platform"] == peer["platform"])
        text += (
            f" On {_where(peer)} `{PEER}` takes {_milliseconds(peer['milliseconds'])} ms,"
            f" {peer['ratio'] / without['ratio']:.2f} of the time of GFFE without the network there, and reaches"
            f" {peer['psnr']:.2f} dB."
        )
    text += f" GFFE is not ahead everywhere: {'; '.join(ahead)}." if ahead else ""
    return "\n".join(textwrap.wrap(text, LINE, break_on_hyphens=False))


def times_text() -> str:
    """Return the times of a frame of 1920×1080, for the README."""
    default, fast = (recorded(name)["devices"][0]["sizes"][0] for name in ("gpu", "gpu_performance"))
    gae, scn = (default["milliseconds"][part] for part in ("GAE", "SCN"))
    wall, preset = default["wall"], fast["milliseconds"]["GAE"]
    rows = {name: _method(name) for name in ("gffe", "no-scn", "performance", PEER)}
    of_full, of_gae, of_preset, of_peer = (_milliseconds(row["milliseconds"]) for row in rows.values())
    less = {name: rows["gffe"]["psnr"] - row["psnr"] for name, row in rows.items()}
    return (
        f"**Time of a 1080p frame**: on an NVIDIA H100 {gae + scn:.2f} ms of kernels with the network"
        f" ({wall:.2f} ms by wall time), {gae:.2f} ms without it, and {preset:.2f} ms with `--preset performance`"
        f" ([by stage](docs/performance.md#gpus-measured)). On two cores of an AMD EPYC {of_full} ms with the network,"
        f" {of_gae} ms without it, and {of_preset} ms with `--preset performance`, which gives"
        f" {less['performance']:.1f} dB less than the default on `plaza`. The cheapest"
        f" [other method](docs/performance.md#other-methods) takes {of_peer} ms, with"
        f" {less[PEER]:.1f} dB less there. `gffe bench --device gpu` measures yours."
    )


def methods_plot() -> str:
    points = [
        Point(row["milliseconds"], row["psnr"], _label(row), "#2f6fde" if row["method"] in OURS else "#d98b1f")
        for row in _methods()
    ]
    return scatter(points, "ms for one new frame", "PSNR, dB")


TABLES: dict[str, Callable[[], str]] = {
    "memory": memory_table,
    "traffic_size": size_of_traffic,
    "traffic": traffic_table,
    "gpu": gpu_table,
    "methods_text": methods_text,
    "methods": methods_table,
    "methods_regions": regions_table,
}


def with_tables(text: str) -> str:
    """Return the page with all its tables as the records have them now."""
    return with_all(text, {name: make() for name, make in TABLES.items()})


def with_times(text: str) -> str:
    """Return the README with the times as the records have them now."""
    return with_all(text, {"times": times_text()})


def measure(sequence: Path | None, device: str | None) -> None:
    """Record the commands and the memory."""
    from gffe_cl.engine.opencl.device import open_device

    found = dict(counted(open_device(device, profiling=True), [*SCENES, *([str(sequence)] if sequence else [])]))
    (MEASURED / "memory.json").write_text(json.dumps(found, indent=1) + "\n")


def counted(device, subjects: list[str]) -> Iterator[tuple[str, dict]]:
    from gffe_cl.engine.options import Options
    from gffe_cl.engine.timing.bench import Copier, bench_size
    from gffe_cl.lab.bench.footage import loop_of

    copier = Copier(device)
    for subject in subjects:
        loop = loop_of(device, subject, SIZE)
        result = bench_size(device, copier, loop, Options(), repeats=1)
        yield (
            loop.name,
            {
                "size": SIZE,
                "commands": result.commands,
                "memory_gae": result.memory_gae,
                "memory_by_stage": result.memory_by_stage,
            },
        )


def _methods() -> list[dict]:
    return recorded("methods")["sizes"][0]["methods"]


def _method(name: str) -> dict:
    """Return the row of a method on the first device that it ran on."""
    return next(row for row in _methods() if row["method"] == name)


def _shares() -> dict[str, float]:
    return {region: share for region, share in recorded("methods")["sizes"][0]["share"].items() if share}


def _share_of_error(row: dict, region: str) -> float:
    """Return a region's share of the squared error of all pixels."""
    return _shares()[region] * 10 ** ((row["psnr"] - row["regions"][region]) / 10)


def _where(row: dict) -> str:
    return _runtime(f"{row['device']} ({row['platform']})") if row["device"] else "host"


def _label(row: dict) -> str:
    return f"{row['method']}, {_where(row)}" if row["device"] else row["method"]


def _milliseconds(value: float) -> str:
    return f"{value:.1f}" if value < 10 else f"{value:.0f}"


def _runtime(device: str) -> str:
    """Return the short name of a device, from "name (platform)"."""
    known = {"Intel(R) OpenCL": "Intel's runtime", "Portable Computing Language": "PoCL"}
    return next((short for platform, short in known.items() if f"({platform})" in device), device)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--measure", action="store_true")
    parser.add_argument("--sequence", type=Path)
    parser.add_argument("--device")
    asked = parser.parse_args()
    if asked.measure:
        measure(asked.sequence, asked.device)
    PAGE.write_text(with_tables(PAGE.read_text()))
    README.write_text(with_times(README.read_text()))
    (PICTURES / "methods.svg").write_text(methods_plot())


if __name__ == "__main__":
    main()
