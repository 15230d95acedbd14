"""Report as one HTML file: figures and pictures are in it, nothing is fetched, `page.js` does the rest."""

from __future__ import annotations

import base64
import json
from importlib.resources import files

from gffe_cl.captures.report_style import report_style
from gffe_cl.lab.table.results import PAPER
from gffe_cl.lab.table.runner import Filled

_FRAME = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>GFFE evaluation, {date}</title>
<style>
{css}</style>
</head>
<body>
<main id="report"><noscript>This report needs JavaScript; results.json beside it does not.</noscript></main>
<script type="application/json" id="results">{results}</script>
<script type="application/json" id="pictures">{pictures}</script>
<script>
{js}</script>
</body>
</html>
"""


def page(results: dict, filled: Filled) -> str:
    """Return an HTML document of `results`, which come from `results_of(filled)`."""
    pictures: dict[str, dict] = {name: {"": _data(cell.pictures)} for name, cell in filled.described.items()}
    for (sequence, method), cell in filled.cells.items():
        pictures[sequence][method] = _data(cell.pictures)
    return _FRAME.format(
        date=results["date"],
        css=report_style() + _resource("page.css"),
        js=_resource("page.js"),
        results=_embedded(results | {"paper": PAPER}),
        pictures=_embedded(pictures),
    )


def _data(pictures: dict[str, bytes]) -> dict[str, str]:
    return {name: "data:image/webp;base64," + base64.b64encode(data).decode() for name, data in pictures.items()}


def _embedded(document: dict) -> str:
    """Return JSON for a script element, which no name of a file can end early."""
    return json.dumps(document, allow_nan=False).replace("<", "\\u003c")


def _resource(name: str) -> str:
    return files("gffe_cl.lab.table").joinpath(name).read_text("utf-8")
