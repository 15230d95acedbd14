"""Docstrings are sentences that are true and stand alone: an editor's hover shows nothing else."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PYTHON = ("gffe_cl", "viewer", "docs/tools", "tests/helpers")  # folders whose docstrings are checked
KERNELS = ("kernels",)
GENERATED = {"gffe_config.h", "gffe_tables.c"}  # by `gffe export`

FRAGMENT = re.compile(
    r"(Of|As|The same|Their|Its|It|Whose|What|Which|That|Those|These|By|With|Without|For|To|At|In|From|Where|How|When"
    r"|And|But|So|Both|Each|Also)\b|[^\w`(]|\(.*?\) \w+: |\([^)]*\)[ ,;:]|\w+Error\b"
)
NOT_A_VERB = re.compile(r"(The|A|An|One|All|Whether|\w+s? of)\b|[^A-Z]")


def faults_of(node: ast.AST) -> Iterator[str]:
    """Yield what is wrong with the docstring of a module, class or function."""
    text = ast.get_docstring(node)
    if text is None:
        return
    first = text.partition("\n\n")[0].replace("\n", " ")
    if FRAGMENT.match(first):
        yield "begins as a part of a sentence"
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or _is_property(node):
        return
    if NOT_A_VERB.match(first):
        yield "begins without a verb"
    gives = _gives(node)
    if not gives and re.match(r"(Return|Yield)s?\b", first):
        yield "promises a result where nothing is returned"
    if gives == "return" and not re.search(r"\b([Rr]eturn|[Yy]ield)", text):
        yield "does not say that something is returned"


def _is_property(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return any(re.search(r"property|\.setter", ast.unparse(decorator)) for decorator in node.decorator_list)


def _gives(node: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    """Return "return" or "yield", "" if the function gives nothing, and "unknown" for the body of a declaration."""
    rest = node.body[1:]  # without the docstring
    if all(isinstance(part, ast.Raise) or ast.unparse(part) == "..." for part in rest) and node.returns:
        return "" if _is_none(node.returns) else "unknown"
    inside: list[ast.AST] = [*node.body]
    found = ""
    while inside:
        part = inside.pop()
        if isinstance(part, ast.Yield | ast.YieldFrom):
            return "yield"
        if isinstance(part, ast.Return) and part.value and not _is_none(part.value):
            found = "return"
        if not isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda | ast.ClassDef):
            inside += ast.iter_child_nodes(part)
    return found


def _is_none(value: ast.expr) -> bool:
    return isinstance(value, ast.Constant) and value.value is None


def comments_of(kernels: str) -> Iterator[tuple[str, str]]:
    """Yield the name of each kernel in the text of a file, and the comment right above it."""
    for comment, name in re.findall(r"/\*((?:(?!\*/).)*)\*/\s*(?:\w+ )?__kernel\b.*?\bvoid (\w+)\(", kernels, re.S):
        yield name, " ".join(comment.split())


def _nodes(text: str) -> Iterator[tuple[str, ast.AST]]:
    tree = ast.parse(text)
    yield "", tree
    inside = [*tree.body]
    while inside:
        node = inside.pop()
        inside += getattr(node, "body", [])
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield f":{node.lineno} {node.name}", node


def _sources(folders: tuple[str, ...], pattern: str) -> Iterator[Path]:
    return (path for folder in folders for path in sorted((ROOT / folder).rglob(pattern)))


def test_docstrings_are_sentences_that_are_true():
    everything = _sources(("gffe_cl", "viewer", "kernels", "tests", "docs"), "*.*")
    files = {path.name for path in everything} | GENERATED
    found, count = [], 0
    for path in _sources(PYTHON, "*.py"):
        for place, node in _nodes(path.read_text("utf-8")):
            text = ast.get_docstring(node) or ""
            count += bool(text)
            named = re.findall(r"[\w/]*?(\w+\.(?:py|cl|h|c))\b(?!\()", text)
            faults = [*faults_of(node), *(f"names {name}, which is gone" for name in named if name not in files)]
            found += [f"{path.relative_to(ROOT)}{place}: {fault}" for fault in faults]
    assert not found, "\n".join(found)
    assert count > 1500


def test_comments_above_kernels_are_sentences():
    files = [*_sources(KERNELS, "*.cl")]
    above = [(path.name, name, text) for path in files for name, text in comments_of(path.read_text("utf-8"))]
    assert not [f"{file}, {name}: {text[:60]}" for file, name, text in above if FRAGMENT.match(text)]
    assert above or not KERNELS


@pytest.mark.parametrize(
    ("code", "fault"),
    [
        ('def f(x):\n    "Return the sum."\n    x.add(1)', "promises"),
        ('def f(x) -> None:\n    "Return a number."', "promises"),
        ('def f(x):\n    "Return a number."\n    def g():\n        return 1\n    g()', "promises"),
        ('def f(x):\n    "Add one to `x`."\n    return x + 1', "does not say"),
        ('def f(x):\n    "Of that name."\n    return x', "part"),
        ('def f(x):\n    "Width and height."\n    return x', "does not say"),
        ('def f(x):\n    "`x` as a float."\n    return x', "without a verb"),
        ('"Their names."', "part"),
    ],
)
def test_a_wrong_docstring_is_found(code, fault):
    tree = ast.parse(code)
    assert any(fault in each for node in (tree, *tree.body) if _may_have(node) for each in faults_of(node))


def _may_have(node: ast.AST) -> bool:
    return isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)


@pytest.mark.parametrize(
    "code",
    [
        'def f(x):\n    "Return the sum."\n    return x + 1',
        'def f(x):\n    "Yield numbers."\n    yield 1',
        'def f(self) -> int:\n    "Return a number."\n    ...',
        'class A:\n    "Sum of numbers."\n    @property\n    def f(self):\n        "The sum."\n        return 1',
    ],
)
def test_a_right_docstring_is_accepted(code):
    tree = ast.parse(code)
    assert not [each for node in ast.walk(tree) if _may_have(node) for each in faults_of(node)]


def test_comments_above_kernels_are_found():
    text = "/* Not. */\nint f();\n\n/* As before,\n   but faster. */\nWIDE __kernel void g(__global float *x)\n{}\n"
    assert [*comments_of(text)] == [("g", "As before, but faster.")]
    assert FRAGMENT.match("As before, but faster.")
