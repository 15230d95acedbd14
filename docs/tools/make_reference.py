"""Writes the reference of the Python interface, docs/reference.md, from the docstrings.

    python docs/tools/make_reference.py

What is in it is what `gffe_cl.__all__` names.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator

from pages import DOCS

import gffe_cl

PAGE = DOCS / "reference.md"
_SECTIONS = ("Parameters", "Attributes", "Returns", "Raises")


def reference() -> str:
    """The whole page."""
    parts = [
        "# Reference of the Python interface",
        "",
        "Made from the docstrings by `python docs/tools/make_reference.py`. Everything here is imported as",
        "`import gffe_cl as gffe`. Conventions of images, motion and cameras: [sequences.md](sequences.md).",
        "",
        *(f"- [`{name}`](#{anchor})" for name, anchor in _anchors().items()),
    ]
    for name in _names():
        parts += ["", f"## {name}", "", *_entry(name, getattr(gffe_cl, name))]
    return "\n".join(parts) + "\n"


def _names() -> list[str]:
    return [name for name in gffe_cl.__all__ if not name.startswith("_")]


def _anchors() -> dict[str, str]:
    """As GitHub makes them: in lower case, and numbered where one has been there before."""
    made: dict[str, str] = {}
    for name in _names():
        before = sum(other.lower() == name.lower() for other in made)
        made[name] = name.lower() + (f"-{before}" if before else "")
    return made


def _entry(name: str, thing: object) -> Iterator[str]:
    if not callable(thing):
        yield f"`{type(thing).__name__}`: see [the options](stages.md#options)."
        return
    exception = isinstance(thing, type) and issubclass(thing, Exception)
    yield from _code(name if exception else f"{name}{_signature(thing)}")
    yield from _text(inspect.getdoc(thing))
    if not isinstance(thing, type):
        return
    for member, value in vars(thing).items():
        if member.startswith("_"):
            continue
        if isinstance(value, property):
            yield from ("", f"### {name}.{member}", "", *_text(inspect.getdoc(value)))
        elif inspect.isfunction(value) or isinstance(value, classmethod):
            bound = value.__func__ if isinstance(value, classmethod) else value
            heading = f"{name}.{member}{_signature(bound, method=True)}"
            yield from ("", f"### {name}.{member}", "", *_code(heading), *_text(inspect.getdoc(bound)))


def _code(line: str) -> tuple[str, ...]:
    return "```python", line, "```", ""


def _signature(thing, method: bool = False) -> str:
    """Parameters as written, annotations and all; `self` and `cls` go."""
    signature = inspect.signature(thing)
    parameters = list(signature.parameters.values())[1 if method else 0 :]
    written, starred = [], False
    written, starred = [], False
    for p in parameters:
        if p.name.startswith("_"):
            continue
        if p.kind is p.KEYWORD_ONLY and not starred:
            written.append("*")
        starred |= p.kind in (p.KEYWORD_ONLY, p.VAR_POSITIONAL)
        text = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "") + p.name
        if p.annotation is not p.empty:
            text += f": {_annotation(p.annotation)}"
        if p.default is not p.empty:
            default = "…" if "<" in repr(p.default) else repr(p.default)
            text += f" = {default}" if p.annotation is not p.empty else f"={default}"
        written.append(text)
    made = f"({', '.join(written)})"
    returned = signature.return_annotation
    if returned is signature.empty or isinstance(thing, type):
        return made
    return f"{made} -> {_annotation(returned)}"


def _annotation(annotation) -> str:
    return annotation if isinstance(annotation, str) else getattr(annotation, "__name__", str(annotation))


def _text(docstring: str | None) -> Iterator[str]:
    """Markdown of a docstring: sections in bold, their entries as lists."""
    lines = (docstring or "").splitlines()
    section = ""
    for k, line in enumerate(lines):
        if line in _SECTIONS and k + 1 < len(lines) and set(lines[k + 1]) == {"-"}:
            section = line
            yield from (f"**{line}**", "")
        elif section and set(line) == {"-"}:
            continue
        elif section and line and not line.startswith(" "):
            if not _is_entry(lines, k):
                section = "" if k and not lines[k - 1] else section
                yield line
                continue
            name, _, kind = line.partition(" : ")
            yield f"- {_quoted(name)}{f' : {kind}' if kind else ''}"
        else:
            yield line


def _is_entry(lines: list[str], k: int) -> bool:
    return " : " in lines[k] or (k + 1 < len(lines) and lines[k + 1].startswith(" "))


def _quoted(names: str) -> str:
    return re.sub(r"[A-Za-z_]\w*", lambda match: f"`{match[0]}`", names) if "(" not in names else names


def main() -> None:
    PAGE.write_text(reference())


if __name__ == "__main__":
    main()
