"""Command `gffe selftest`, which tests devices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import DeviceOption, JsonOption, OverwriteOption, app, err, out, output_file, plain, write_json

if TYPE_CHECKING:
    from gffe_cl.engine.opencl.device import DeviceInfo
    from gffe_cl.engine.selftest.report import DeviceResult, NetworkResult

_COLORS = {"equal": "green", "differs": "red", "failed": "red", "refused": "yellow"}
_MOST_ROWS = 40


@app.command()
def selftest(
    device: DeviceOption = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            help="File for a fault report: devices, drivers, versions, and everything that differs.",
            callback=output_file("--report"),
        ),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="Quick test: only the kernel variants that the device chooses itself; a quarter of the time.",
        ),
    ] = False,
    seconds: Annotated[float, typer.Option("--timeout", help="Time limit per device, seconds.", min=1.0)] = 600.0,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Run a fixed workload on every device, and compare every buffer with recorded references, bit by bit.

    Exit code 1: something differs; 2: something could not be run.
    """
    from gffe_cl.engine.selftest import report as running

    wanted = {"forms": ["own"]} if quick else None
    found = running.selftest(device, seconds=seconds, wanted=wanted, on_device=_announce)
    out.print(_devices_table(found.devices))
    for network in found.networks:
        _print_network(network)
    _print_differences(found.devices)
    document = found.document()
    write_json(json_path, document)
    write_json(report, {"machine": running.machine(), **document} if report else {})
    if report:
        out.print(plain(f"Report: {report}"))
    elif found.exit_code:
        out.print("To report it: gffe selftest --report FILE")
    raise typer.Exit(found.exit_code)


def _announce(info: DeviceInfo) -> None:
    if info.works:
        err.print(plain(f"Testing {info.name} ({info.platform}), about a minute"))


def _devices_table(results: list[DeviceResult]) -> Table:
    heads = ("index", "device", "platform", "verdict", "compared")
    table = Table(*heads, box=None, header_style="bold")
    for result in results:
        info = result.info
        forms = ", ".join(form["name"] for form in result.forms)
        problem = f": {plain(result.problem)}" if result.problem else ""
        table.add_row(
            info.index,
            plain(info.name),
            plain(info.platform + (f" ({info.driver})" if info.driver else "")),
            f"[{_COLORS[result.verdict]}]{result.verdict}[/]{problem}",
            f"{len(result.buffers)} buffers ({forms})" if forms else "",
        )
    return table


def _print_network(result: NetworkResult) -> None:
    told = result.problem or (f"largest difference {result.largest:.1e}" if result.largest else "bit for bit")
    out.print(f"network on {result.provider}: [{_COLORS[result.verdict]}]{result.verdict}[/], {plain(told)}")


def _print_differences(results: list[DeviceResult]) -> None:
    """Print the differences by device and buffer, of the buffers that differ anywhere."""
    others = sorted({case for result in results for case in result.other_inputs})
    if others:
        out.print(f"NumPy makes other frames here than were recorded ({', '.join(others)}): no device's fault.")
    worst = [(result, result.worst()) for result in results if result.forms]
    names = sorted({name for _, found in worst for name in found})
    if not names:
        return
    table = Table("differs: largest ulp, pixels", *(plain(result.info.index) for result, _ in worst), box=None)
    for name in names[:_MOST_ROWS]:
        table.add_row(plain(name), *(_cell(found.get(name)) for _, found in worst))
    out.print(table)
    if len(names) > _MOST_ROWS:
        out.print(f"… and {len(names) - _MOST_ROWS} more buffers")


def _cell(told: dict | None) -> str:
    if told is None:
        return "equal"
    where = ", ".join(sorted(told["forms"])) + "; " + ", ".join(sorted(told["cases"]))
    if told["ulp"] is None:
        return f"at {told['moments']} moments ({where})"
    return f"{told['ulp']} ulp, {told['pixels']} px ({where})"
