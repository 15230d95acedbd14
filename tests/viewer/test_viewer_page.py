"""Pages for a browser (`gffe view --export`): made without a display, and what Chromium shows of them."""

import re
import shutil
import subprocess

import numpy as np
import pytest
import tiny_sequence
from PIL import Image

from gffe_cl import Options
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.lab.metrics import psnr, to_display
from gffe_cl.viewer.engine.sources.opening import ScenePlan
from gffe_cl.viewer.state.page import Exporter, Plan

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


def export(folder, target, steps=lambda text, total: lambda: None, overwrite=False, **choices):
    options = Options(shading_correction=False)
    exporter = Exporter(Plan(str(target), ScenePlan(32, 24, 0), options, **choices))
    try:
        return exporter.write(folder, overwrite, steps)
    finally:
        exporter.close()


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    sequence = tiny_sequence.write(folder / "in", frames=4)
    said = export(folder / "page", sequence, layers="final,frame.depth,rendered.depth", frames="3..5,7")
    return folder / "page", sequence, said


def shown(page, hash):
    """Texts of the values, of the frame and of the plotted figure that a browser shows."""
    if CHROMIUM is None:
        pytest.skip("no Chromium: apt-get install chromium")
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={page.parent / 'browser'}"]
    place = f"{(page / 'index.html').as_uri()}{hash}"
    done = subprocess.run(
        [*command, "--virtual-time-budget=10000", "--dump-dom", place], capture_output=True, text=True, timeout=100
    )
    inside = re.search(r'id="values">(.*?)</div>\n', done.stdout)
    assert inside, done.stdout + done.stderr
    texts = [re.search(rf'id="{id}"[^>]*>(.*?)<', done.stdout)[1] for id in ("frame", "figure")]
    return re.findall(r"<div>(.*?)</div>", inside[1] + "</div>"), *texts


def test_files_of_a_page(page):
    folder, _, said = page
    assert re.fullmatch(rf"4 frames, .* MiB: open {re.escape(str(folder))}/index.html in a browser", said)
    names = tiny_sequence.names(folder)
    assert {"index.html", "page.js", "data.js", "frames/00003.js", "frames/00003.final.e.png"} <= set(names)
    assert "frames/00004.frame.depth.a.png" not in names  # a rendered frame has none
    picture = np.asarray(Image.open(folder / "frames" / "00003.final.a.png"))
    assert picture.shape == (tiny_sequence.H, tiny_sequence.W, 3) and picture.std() > 10


@pytest.mark.slow
def test_a_browser_shows_the_values(page):
    """Truth under the pixel to the digit, and a figure that the pictures have."""
    folder, *_ = page
    truth = tiny_sequence.pixels(101)[0]
    values, frame, figure = shown(folder, "#frame=3&mode=wipe&pixel=4,5")
    numbers = "  ".join(f"{name} {float(f'{value:.4g}'):g}" for name, value in zip("RGB", truth[5, 4], strict=True))
    assert values[0] == "pixel 4, 5" and values[2] == f"B  {numbers}" and frame == "generated: frame 1 + 1/2"
    assert float(values[3].split()[1]) > 0
    final = np.asarray(Image.open(folder / "frames" / "00003.final.a.png")) / 255
    assert float(figure.split()[1]) == pytest.approx(psnr(final, to_display(truth)), abs=0.05)
    values, frame, _ = shown(folder, "#frame=5&layer=rendered.depth&mode=A&pixel=0,0")
    assert values == ["pixel 0, 0", "A  sky"] and frame == "generated: frame 2 + 1/2"


@pytest.mark.slow
def test_b_from_a_folder(page, tmp_path):
    """Another sequence's pictures beside the computed ones; all layers."""
    other = tiny_sequence.write(tmp_path / "other", frames=4)
    said = export(tmp_path / "page", page[1], layers="", frames="3", other=str(other))
    names = tiny_sequence.names(tmp_path / "page")
    assert said.startswith("1 frames") and len([name for name in names if name.endswith(".a.png")]) > 20
    truth = to_display(tiny_sequence.pixels(101)[0])
    np.testing.assert_allclose(
        np.asarray(Image.open(tmp_path / "page/frames/00003.final.b.png")) / 255, truth, atol=1.01 / 255
    )


@pytest.mark.parametrize(
    ("choices", "told"),
    [
        ({"frames": "99"}, "expected 0 to 7"),
        ({"frames": "5..3"}, "expected FIRST..LAST, got '5..3'"),
        ({"layers": "final,nonsense"}, "no layer is called 'nonsense'"),
        ({"other": "nowhere"}, "no layer is called 'nowhere'"),
        ({"compare": "difference"}, "--compare of a page must be one of off, split, error"),
    ],
)
def test_wrong_choices_leave_nothing(page, tmp_path, choices, told):
    with pytest.raises(GffeError, match=re.escape(told)):
        export(tmp_path / "new", page[1], **choices)
    assert tiny_sequence.names(tmp_path) == []


def test_folders_that_are_there(page, tmp_path):
    """An interrupted page leaves the one before; other folders are kept."""

    def interrupted(text, total):
        raise KeyboardInterrupt

    folder, sequence, _ = page
    before = tiny_sequence.names(folder)
    with pytest.raises(GffeError, match="--overwrite replaces the earlier page"):
        export(folder, sequence)
    with pytest.raises(KeyboardInterrupt):
        export(folder, sequence, interrupted, overwrite=True)
    assert tiny_sequence.names(folder) == before and not list(folder.parent.glob(".gffe*"))
    (tmp_path / "mine").write_text("")
    with pytest.raises(GffeError, match=r"exists \(expected a new or an empty folder\)"):
        export(tmp_path, sequence, overwrite=True)
