"""Writes the tables of the documentation that repeat what the program declares.

    python docs/tools/make_tables.py

`TABLES` names them.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from types import FunctionType

from pages import DOCS, table, with_all
from typer.main import get_command

import gffe_cl
from gffe_cl.captures.formats import FORMATS
from gffe_cl.captures.scenes import SCENES, SITUATIONS
from gffe_cl.cli.commands import app
from gffe_cl.engine.options import HOLE_FILLINGS, OPTIONS, PRESETS, Option
from gffe_cl.engine.pipeline.outputs import STAGES
from gffe_cl.engine.stages.background import Background, _level_buffers
from gffe_cl.engine.stages.base import Stage
from gffe_cl.engine.stages.buffers import EXTRAPOLATED, FILLED_BY, RENDERED, BufferSpec
from gffe_cl.engine.stages.holes import FarSide, HoleFilling
from gffe_cl.engine.stages.presentation import Composition, Presentation
from gffe_cl.engine.stages.upload import Upload

# Default hole filling, and the stages for NumPy arrays, a window, and overlays.
_USUAL = (FarSide if stage is HoleFilling else stage for stage in STAGES)
SHOWN: tuple[type[Stage], ...] = (Upload, *_USUAL, Presentation, Composition)


def options_table() -> str:
    """Return every option: field of `Options`, flag, values, default, sentence."""
    rows = [
        (f"`{o.name}`", f"`{o.flag}`" if o.flag else "", _values(o), _default(o), o.sentence) for o in OPTIONS.values()
    ]
    return table(("in Python", "command line", "values", "default", "what it does"), rows)


def presets_table() -> str:
    """Return every preset: its name, its sentence, and the options that it sets."""
    rows = [
        (f"`{name}`", preset.sentence, ", ".join(f"`{option}={value!r}`" for option, value in preset.values.items()))
        for name, preset in PRESETS.items()
    ]
    return table(("`--preset`", "what it does", "`Options.preset`"), rows)


def fillings_table() -> str:
    return table(
        ("`--hole-filling`", "its color …"), [(f"`{name}`", sentence) for name, sentence in HOLE_FILLINGS.items()]
    )


def stages_table() -> str:
    """Return every stage: the paper's section, its sentence, the buffers that its kernels read and write."""
    rows = []
    for stage in SHOWN:
        reads, writes = _accessed(stage, "reads"), _accessed(stage, "writes")
        reads = [name for name in reads if not name.startswith(f"{stage.name}.") or name.endswith("'")]
        about = _first_sentence(inspect.getdoc(stage))
        rows.append((f"`{stage.name}`", stage.paper, about, _quoted(reads), _quoted(writes)))
    return table(("stage", "the paper's section", "what it does", "reads", "writes"), rows)


def buffers_table() -> str:
    """Return every buffer, with its pixels, type, bytes and meaning."""
    rows = [row for name, specs in (("rendered", RENDERED), ("frame", EXTRAPOLATED)) for row in _described(name, specs)]
    for stage in SHOWN:
        specs = _level_buffers(0) if stage is Background else stage.buffers
        rows += _described(stage.name, [spec for spec in specs if not spec.scratch])
    return table(("owner", "buffer", "pixels of", "type", "bytes", "meaning"), rows)


def labels_table() -> str:
    return table(("`filled_by`", "the pixel comes from"), [(str(value), name) for value, name in FILLED_BY])


def scenes_table() -> str:
    return table(("scene", "what it shows"), [(f"`{name}`", text) for name, text in SCENES.items()])


def situation_scenes_table() -> str:
    return table(("situation", "content"), [(f"`{name}`", text) for name, text in SITUATIONS.items()])


def formats_table() -> str:
    """Return all supported formats of captures, with an example of a folder."""
    rows = [
        (f"`{one.name}`", one.sentence, "<br>".join(f"`{line}`" for line in one.example.splitlines()))
        for one in FORMATS.values()
    ]
    return table(("format", "description", "folder, for example"), rows)


def names_table() -> str:
    """Return every public name: its sentence, and the methods and properties of classes."""
    rows = []
    for name in gffe_cl.__all__:
        value = getattr(gffe_cl, name)
        if callable(value):
            rows.append((f"`{name}`", _first_sentence(inspect.getdoc(value)), _quoted(_members(value))))
    return table(("name", "what it is or does", "methods and properties"), sorted(rows))


def commands_table() -> str:
    """Return every command with its arguments and its sentence."""
    rows = []
    for name, command in get_command(app).commands.items():
        given = [p for p in command.params if p.param_type_name == "argument"]
        arguments = [p.name.upper() if p.required else f"[{p.name.upper()}]" for p in given]
        if not command.hidden:
            rows.append((f"`{' '.join(('gffe', name, *arguments))}`", _first_sentence(command.help)))
    return table(("command", "what it does"), rows)


TABLES: dict[str, Callable[[], str]] = {
    "options": options_table,
    "presets": presets_table,
    "fillings": fillings_table,
    "stages": stages_table,
    "buffers": buffers_table,
    "labels": labels_table,
    "scenes": scenes_table,
    "situation_scenes": situation_scenes_table,
    "formats": formats_table,
    "names": names_table,
    "commands": commands_table,
}


def with_tables(text: str) -> str:
    """Return a page with all its tables as the program has them now."""
    return with_all(text, {name: make() for name, make in TABLES.items()})


def _members(kind: type) -> list[str]:
    """Return the names of the public methods and properties of a class in their order; none of anything else."""
    own = vars(kind).items() if isinstance(kind, type) else ()
    return [name for name, value in own if name[0] != "_" and isinstance(value, property | classmethod | FunctionType)]


def _accessed(stage: type[Stage], kind: str) -> list[str]:
    """Return the buffers that the stage's kernels read or write, scratch left out; l stands for a level."""
    scratch = ("keys", "winners", ".l", ".weightsl", ".numbersl")  # the last three: of the network's layers
    names = [
        name.format_map(_Chosen(kernel.choices, k))
        for kernel in stage.kernels
        for name in getattr(kernel, kind).values()
        for k in range(max(map(len, kernel.choices.values()), default=1))
    ]
    names = [re.sub(r"\{\w+\}", "l", name) for name in names]
    return list(dict.fromkeys(name for name in names if not name.rstrip("'").endswith(scratch)))


class _Chosen(dict):
    """Choice number `k` of each name; names without any stay in braces."""

    def __init__(self, choices: Mapping[str, tuple[str, ...]], k: int):
        super().__init__({name: those[k] for name, those in choices.items()})

    def __missing__(self, name: str) -> str:
        return f"{{{name}}}"


def _described(owner: str, specs: Iterable[BufferSpec]) -> list[tuple[str, ...]]:
    rows = []
    for k, spec in enumerate(specs):
        kind = f"{spec.dtype.__name__}{f' ×{spec.channels}' if spec.channels > 1 else ''}"
        kind = spec.packing.name if spec.packing else kind
        planes = f", {spec.planes} planes" if spec.planes > 1 else ""
        size = str(spec.bytes_per_pixel * spec.planes * (1 + spec.kept))
        owned = f"**`{owner}`**" if k == 0 else ""
        rows.append((owned, f"`{spec.name}`", spec.grid, kind + planes, size, spec.description))
    return rows


def _quoted(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _first_sentence(text: str) -> str:
    paragraph = " ".join(text.partition("\n\n")[0].split())
    sentence = re.match(r".*?[.:](?=\s+[A-Z`])", paragraph)
    return (sentence[0] if sentence else paragraph).rstrip(".:")


def _values(option: Option) -> str:
    if option.choices:
        return ", ".join(f"`{name}`" for name in option.choices)
    if option.kind is bool:
        return "on, off"
    if option.kind is str:
        return "text"
    return option.expected.partition(", ")[2].partition(", or ")[0] + (f" {option.unit}" if option.unit else "")


def _default(option: Option) -> str:
    if option.default is None:
        return option.automatic.partition(":")[0]
    return {True: "on", False: "off"}[option.default] if option.kind is bool else str(option.default)


def main() -> None:
    for page in sorted(DOCS.glob("*.md")):
        old = page.read_text()
        if (new := with_tables(old)) != old:
            page.write_text(new)
            print(f"{page.name}: written")


if __name__ == "__main__":
    main()
