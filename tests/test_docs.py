"""The documentation says what is: examples run, commands parse, links lead somewhere, made parts are new."""

import contextlib
import io
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

import gffe_cl
from gffe_cl.captures.sequence.description import Description, FrameEntry, describe
from gffe_cl.cli.commands import app, invoke
from gffe_cl.engine.core.public_names import GONE, removal

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")] + sorted(
    (ROOT / "docs").glob("*.md")
)
TEXTS = {page.relative_to(ROOT).as_posix(): page.read_text() for page in PAGES}
EXAMPLES = [
    pytest.param(code, printed, id=f"{name}-{k}")
    for name, text in TEXTS.items()
    for k, (printed, code) in enumerate(re.findall(r"<!-- prints: (.*?) -->\n```python\n(.*?)```", text, re.S))
]


@pytest.mark.parametrize(("code", "expected"), EXAMPLES)
def test_examples_print_what_the_page_says(code, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "example", "exec"), {})
    assert printed.getvalue().strip() == expected


def test_every_python_example_is_run():
    of_the_viewer = 2  # the panel of docs/map.md, which runs in the window's test
    written = sum(text.count("```python") for text in TEXTS.values())
    assert written - of_the_viewer == len(EXAMPLES) >= 5


@pytest.mark.long
@pytest.mark.device
def test_the_notebook_runs(device, tmp_path, monkeypatch):
    """Its ten cells in their order; lines that begin with ! are commands, and the last cell shows a picture."""
    monkeypatch.chdir(tmp_path)
    cells = json.loads((ROOT / "docs/examples/ten_cells.ipynb").read_text())["cells"]
    names, printed = {}, io.StringIO()
    for text in ("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"):
        for line in re.findall(r"^!gffe (.*)\n", text, re.M):
            assert invoke(shlex.split(line)) == 0
        with contextlib.redirect_stdout(printed):
            exec(re.sub(r"^!.*", "", text, flags=re.M), names)
    repeated, extrapolated = map(float, re.findall(r"([\d.]+) dB", printed.getvalue()))
    assert len(cells) == 10 and extrapolated > repeated + 3 and names["picture"].size == (960, 540)


def _without_blocks(text):
    return re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M)


# Paragraphs whose figures in dB no record holds: never more.
UNRECORDED = {"docs/upscaling.md": 1}


@pytest.mark.parametrize("page", TEXTS)
def test_figures_in_decibels_come_from_records(page):
    """A paragraph that states dB links the record that holds them, made by `quality.py --write`, or names the script of
    the repository that prints them. Commands make tables and blocks."""
    text = re.sub(r"<!-- (\S+):begin -->.*?<!-- \1:end -->", "", _without_blocks(TEXTS[page]), flags=re.S)
    unrecorded = []
    for paragraph in re.split(r"\n\s*\n|\n\s*(?=- )", text):
        stated = " ".join(re.findall(r"\d*\.?\d+(?:(?:,| and| to) [+−]?\d*\.?\d+)* dB", paragraph))
        named = re.findall(r"measured/(\w+)\.json", paragraph) if stated else ()
        held = [db for name in named for db in _gains(name)]
        if re.search(r"`python docs/\w+/\w+\.py|\]\(examples/\w+\.py\)", paragraph):
            continue
        for figure in re.findall(r"\d*\.?\d+", stated):
            half = 0.51 * 10.0 ** -len(figure.partition(".")[2])
            if not any(abs(abs(db) - float(figure)) <= half for db in held):
                unrecorded.append(paragraph)
    assert len(set(unrecorded)) == UNRECORDED.get(page, 0), unrecorded


def _gains(name):
    """dB gained by the groups and the sequences of a record, at both times, with and without the network."""
    record = json.loads((ROOT / f"docs/measured/{name}.json").read_text())
    yield from (db for of in record["gains"].values() for db, _ in of.values())
    yield from (after - before for of in record["values"].values() for before, _, _, after, _, _ in of.values())


def test_records_say_what_made_them():
    for path in (ROOT / "docs/measured").glob("*.json"):
        record = json.loads(path.read_text())
        assert record["commit"].strip() and record["command"].startswith(("gffe ", "python docs/tools/")), path.name


def _commands():
    """(page, words after `gffe`) of every line of a block that begins with it."""
    for name, text in TEXTS.items():
        for language, block in re.findall(r"^```(\w*)\n(.*?)^```$", text, re.S | re.M):
            for line in block.splitlines() * (not language):
                words = shlex.split(line, comments=True)
                if words and Path(words[0]).name == "gffe":
                    yield pytest.param(words[1:], id=f"{name}: {' '.join(words)}")


@pytest.mark.parametrize("words", list(_commands()))
def test_commands_parse(words, tmp_path, monkeypatch):
    """As the command line parses them: the command, its options, their values' types, no argument missing."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    get_command(app).commands[words[0]].make_context(words[0], words[1:])


def test_commands_that_prose_names_exist():
    commands = get_command(app).commands
    for name, text in TEXTS.items():
        for quoted in re.findall(r"`gffe ([^`]+)`", _without_blocks(text)):
            words = quoted.split()
            if words[0] in ("COMMAND", "study", "--version") or removal(f"gffe {words[0]}"):  # of the changelog
                continue
            known = {flag for p in commands[words[0]].params for flag in (*p.opts, *p.secondary_opts)} | {"--help"}
            options = {word for word in words if re.match(r"--?[a-z]", word)} - known
            assert {f"gffe {words[0]} {option}" for option in options} <= set(GONE), f"{name}: gffe {quoted}"


def _anchors(text):
    headings = re.findall(r"^#+ (.+)$", _without_blocks(text), re.M)
    made = []
    for heading in headings:
        anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        made.append(anchor + (f"-{made.count(anchor)}" if anchor in made else ""))
    return made


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_somewhere(name):
    for link in re.findall(r"\]\(([^)\s]+)\)", _without_blocks(TEXTS[name])):
        if link.startswith(("http://", "https://")):
            continue
        path, _, anchor = link.partition("#")
        page = (ROOT / name).parent / path if path else ROOT / name
        assert page.exists(), link
        if anchor:
            assert anchor in _anchors(page.read_text()), link


def test_anchors_into_the_code_are_there():
    found = re.findall(r"`([\w/]+\.(?:py|cl)): ([\w.]+)`", TEXTS["docs/read_the_code.md"])
    assert len(found) > 20
    for file, name in found:
        text = (ROOT / file).read_text()
        for part in name.split("."):  # of a class, its method
            start = re.search(rf"^ *(?:class|def) {part}\b|^[A-Za-z][^;#]*\b{part}\(", text, re.M)
            assert start, f"{file}: {name}"
            text = text[start.start() :]


def test_the_readme_is_short():
    lines = TEXTS["README.md"].splitlines()
    assert len(lines) <= 130 and max(map(len, lines)) <= 160
    first = "\n".join(lines[:16])  # a screen: what it is, a film, three commands
    assert "docs/pictures/demo.webp" in first and re.search(r"```\n(.+\n){3}```", first)


def test_pictures_are_used():
    used = {Path(link).name for text in TEXTS.values() for link in re.findall(r"pictures/[\w.]+", text)}
    assert {picture.name for picture in (ROOT / "docs" / "pictures").iterdir()} == used


def test_tables_are_up_to_date():
    from make_tables import TABLES, with_tables

    for name, text in TEXTS.items():
        if name.startswith("docs/"):
            assert with_tables(text) == text, f"{name}: run python docs/tools/make_tables.py"
    for table in TABLES:
        assert any(f"<!-- {table}:begin -->\n|" in text for text in TEXTS.values()), table


def test_tables_of_performance_are_those_of_the_records():
    from make_performance import TABLES, with_tables, with_times

    page = TEXTS["docs/performance.md"]
    assert with_tables(page) == page, "run python docs/tools/make_performance.py"
    readme = TEXTS["README.md"]
    assert with_times(readme) == readme and "times:begin" in readme, "run python docs/tools/make_performance.py"
    assert all(f"<!-- {table}:begin -->\n" in page for table in TABLES)


def test_tables_of_gpu_compilers_are_those_of_the_record():
    from gpu_compilers import TABLES, with_tables

    page = TEXTS["docs/portability.md"]
    assert with_tables(page) == page, "run python docs/tools/gpu_compilers.py --tables"
    assert all(f"<!-- {table}:begin -->\n|" in page for table in TABLES)


def test_tables_of_results_are_those_of_the_record():
    from make_results import TABLES, with_tables

    pages = [TEXTS[name] for name in ("docs/results.md", "README.md")]
    assert [with_tables(page) for page in pages] == pages, "run python docs/tools/make_results.py"
    assert all(any(f"<!-- {table}:begin -->\n|" in page for page in pages) for table in TABLES)


def test_tables_of_deviations_are_those_of_the_record():
    from measure_deviations import with_tables
    from pages import recorded

    page = TEXTS["docs/deviations.md"]
    assert with_tables(page, recorded("deviations")) == page, "run python docs/tools/measure_deviations.py --write"


def test_the_reference_has_everything_public():
    listed = re.findall(r"^\.\. (?:auto|py:)\w+:: gffe_cl\.(\w+)$", TEXTS["docs/api.md"], re.M)
    assert sorted([*listed, "__version__"]) == sorted(gffe_cl.__all__)


PAGE = re.compile(r"(?<![\w/])docs/[\w/-]*\w\.\w+|\b[a-z_]+\.md\b")


def test_pages_that_code_names_exist():
    """Messages, help texts, comments and scripts: files of docs/ by their path, pages by their name, and anchors."""
    files = [ROOT / name for name in ("Makefile", "pyproject.toml", ".ci/run", ".ci/package")]
    for folder in ("gffe_cl", "viewer", "kernels", "tests", "docs"):
        files += [
            path for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".pyi", ".cl", ".h", ".c", ".txt")
        ]
    named = set()
    for path in set(files) - {Path(__file__)}:
        for name, anchor in re.findall(rf"({PAGE.pattern})(?:#([\w-]+))?", path.read_text("utf-8")):
            page = ROOT / name if name.startswith("docs/") else ROOT / "docs" / name
            assert page.exists(), f"{path.relative_to(ROOT)}: {name}"
            assert not anchor or anchor in _anchors(page.read_text("utf-8")), (
                f"{path.relative_to(ROOT)}: {name}#{anchor}"
            )
            named.add(name)
    assert {"docs/formats.md", "docs/guide.md", "docs/blender/export_gffe.py", "comparing.md"} <= named


def test_the_specification_of_sequences_has_every_key():
    camera = gffe_cl.Camera(np.eye(4), 4, 4, 2, 2)
    entry = FrameEntry("a.exr", 0.0, "rendered", True, (8, 8), camera, camera.scaled(2, 2), "b.exr", 0.5)
    written = json.loads(describe(Description(4, 4, 30.0, 1.0, [entry], unfinished=True), "test"))
    frame = written["frames"][0]
    page = TEXTS["docs/sequences.md"]
    for key in {*written, *frame, *frame["render_camera"]}:
        assert re.search(rf"^\| [^|]*`{key}`", page, re.M), key
    assert {"unfinished", "alpha", "render_size", "display_camera", "cx"} <= {*written, *frame, *frame["render_camera"]}


def test_deviations_that_are_measured_exist():
    """What `measure_deviations.py` changes is in the kernels, and each of its rows is explained."""
    import measure_deviations as measured

    from gffe_cl.engine.opencl.program import kernel_folder

    for change in (*measured.GAE.values(), *measured.SCN.values(), measured.PAPER, measured.CARRIED):
        for file in {*change.constants, *change.edits}:
            text = (kernel_folder() / file).read_text()
            changed = change.applied(file, text)
            assert changed != text and changed.count("/*") == changed.count("*/")
    page = TEXTS["docs/deviations.md"]
    explained = " ".join(page[: page.index("## Measured")].lower().split())
    for name in (*measured.GAE, *measured.SCN):
        assert name.strip("()… ").lower() in explained, name
        assert f"| {name} |" in page, f"{name}: run python docs/tools/measure_deviations.py --write"
