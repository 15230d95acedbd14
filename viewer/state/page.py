"""Page for a browser: pictures, values and figures of frames, made without a window (`gffe view --export`)."""

from __future__ import annotations

import base64
import json
import shutil
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gffe_cl.engine.core.errors import GffeError, printable
from gffe_cl.engine.core.validation import require_choice
from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.engine.options import Options
from ..engine.engine import Engine
from ..engine.figures import NEEDED, QUANTITIES, Measurer
from ..engine.messages import Failure, Frame, Key, Setup
from ..engine.sources.opening import ScenePlan, make_source, open_viewer_device
from ..engine.store import Want
from ..picture.current_frame import Contents
from ..picture.displays import Display, color_table, fitted, shown_as
from ..picture.looks import Looks
from ..picture.shown_numbers import Texels, texels
from ..picture.view import View, difference
from .actions import found_layer, slot_of
from .captions import layer_text, legend, slot_text
from .parameters import Parameters
from .playback import Playback
from .presets import command_line, of_folder

_FIRST = "const PAGE = "  # of data.js
_MODES = {"off": "A", "split": "wipe", "error": "error"}  # of page.js
_ERROR_HIGH = 0.1  # of display values: it is shown in the brightest color

Steps = Callable[[str, int], Callable[[], Any]]


@dataclass(frozen=True)
class Plan:
    """What is exported: `target` and `scene` are those of `make_source`, `n` and `window` those of `Setup`.

    `frames`: texts of `slot_of` or FIRST..LAST, with commas; empty: all generated frames. `layers`: with commas; empty:
    all. `other`: B, a layer, or a folder with pictures or kernels; None: ground truth if there is any. `compare`: how
    the page begins, a key of _MODES.
    """

    target: str
    scene: ScenePlan
    options: Options
    device: str | None = None
    n: int = 1
    window: str | None = None
    frames: str = ""
    layers: str = names.FINAL
    other: str | None = None
    compare: str = "split"


class Exporter:
    """Writes the page of a plan. `close` it in the end; `left_working`: the device is at work nevertheless."""

    def __init__(self, plan: Plan):
        require_choice(plan.compare, _MODES, "--compare of a page")
        self._plan, self._engine, self._contents = plan, Engine(partial(open_viewer_device, plan.device)), Contents()
        self._looks = Looks(self._contents, {})
        self._of_errors: dict[str, Display] = {}  # by layer
        self._page: dict[str, Any] = {"frames": [], "layers": {}, "figures": {}}

    def close(self) -> None:
        self._engine.close()

    @property
    def left_working(self) -> bool:
        return self._engine.alive

    def write(self, place: Path, overwrite: bool, steps: Steps) -> str:
        """Write the page into the folder `place`, whole or not at all; `steps` opens a progress bar. Returns a sentence
        about it. Raises GffeError."""
        with _new_folder(place, overwrite) as folder:
            self._fill(folder, steps)
            nbytes = sum(path.stat().st_size for path in folder.rglob("*"))
        return f"{len(self._page['frames'])} frames, {nbytes / 2**20:.1f} MiB: open {place / 'index.html'} in a browser"

    def _fill(self, folder: Path, steps: Steps) -> None:
        plan, contents, engine, page = self._plan, self._contents, self._engine, self._page
        engine.start()
        engine.open_source(partial(make_source, plan.target, plan.window, plan.scene))
        self._wait(lambda: engine.source is not None and not engine.busy)
        source: Any = engine.source
        contents.open(source)
        playback = Playback(source.count, source.fps, plan.n)
        parameters = Parameters(plan.options, playback, plan.window)
        parameters.open(source)
        slots, sides = _slots(plan.frames, playback), [parameters.setup]
        contents.take(*self._make(slots[0], sides, frozenset({names.FINAL})))
        layers = [found_layer(contents, name) for name in plan.layers.split(",")] if plan.layers else []
        layers = layers or [spec.name for spec in contents.showable()]
        other, made_by = plan.other or (names.TRUTH if source.has_truth else None), f"A: {self._command(sides[0])}"
        if other is not None and Path(other).is_dir():
            sides.append(self._second(sides[0], Path(other)))
            made_by, other = f"{made_by}   B: {of_folder(Path(other))}", None
        wanted = NEEDED | {names.RENDERED_DEPTH, *layers}
        if other is not None:
            wanted |= {other := found_layer(contents, other)}
        page |= {"title": printable(source.name), "size": contents.size, "made": made_by}
        page["start"] = f"mode={_MODES[plan.compare]}"
        (folder / "frames").mkdir()
        advance, measurers = steps("frames", len(slots)), [Measurer() for _ in sides]
        for slot in slots:
            frames = self._make(slot, sides, wanted)
            contents.take(*frames)
            for side, measurer, frame in zip("ab", measurers, frames, strict=False):
                if frame.moment.alpha:
                    self._note(side, slot, measurer.measure(frame, source.exposure).values)
            shown = {name: self._shown(name, names.of_second(name) if len(sides) > 1 else other) for name in layers}
            self._write_frame(folder / "frames", slot, shown)
            advance()
        order = [*QUANTITIES, *page["figures"]]
        page["figures"] = {name: page["figures"][name] for name in dict.fromkeys(order) if name in page["figures"]}
        for name, new in (("page.html", "index.html"), ("page.js", "page.js")):
            shutil.copyfile(Path(__file__).with_name(name), folder / new)
        (folder / "data.js").write_text(f"{_FIRST}{json.dumps(page)};\n", "utf-8")

    def _command(self, setup: Setup) -> str:
        return f"{command_line(setup, self._contents.source, self._plan.scene.seed)}, on {self._engine.device_name}"

    def _second(self, setup: Setup, folder: Path) -> Setup:
        """Return the setup of B, by kernels or pictures in a folder. Raises GffeError."""
        if next(folder.glob("*.cl"), None) is not None:
            return replace(setup, kernels=self._engine.take_kernels(folder))
        return replace(setup, place=str(folder.absolute()))

    def _wait(self, done: Callable[[], bool]) -> None:
        """Wait for the engine. Raises GffeError where it fails."""
        while not done():
            fault = self._engine.poll()
            if fault is not None or self._engine.build_error:
                raise GffeError(fault.error if fault is not None else str(self._engine.build_error))
            time.sleep(0.002)

    def _make(self, slot: int, sides: list[Setup], layers: frozenset[str]) -> list[Frame]:
        """Return a slot as each of `sides` makes it. Raises GffeError."""
        store = self._engine.store
        wants = [Want(Key(self._engine.recipe(setup), slot), layers, keep=False) for setup in sides]
        store.want(wants)
        self._wait(lambda: all(store.get(want) is not None for want in wants))
        made = [store.get(want) for want in wants]
        for failure in made:
            if isinstance(failure, Failure):
                raise GffeError(failure.error)
        return [frame for frame in made if isinstance(frame, Frame)]

    def _shown(self, name: str, other: str | None) -> dict[str, Texels]:
        """Return a layer of this frame as "a", another one of its kind as "b", and the error between them as "e": as
        many as there are."""
        look = self._looks.of(name)  # of both
        a, b = (texels(one, look, self._contents) for one in (name, other))
        found = {} if a is None else {"a": a}
        if a is None or b is None or other is None or other == name or not _are_alike(a, b):
            return found
        height, width = a.image.shape[:2]
        rows, columns = np.divmod(np.arange(height * width), width)
        values = a.compared(rows, columns), b.compared(*b.beside(a, rows, columns))
        errors = difference(shown_as(a.spec, a.display)[0], "absolute", *values).mean(-1)
        image = np.minimum(errors, 1e18).reshape(height, width)
        spec = LayerSpec("error", "absolute error", a.spec.group, "scalar", grid=a.spec.grid)
        is_fitted = a.spec.view not in ("color", "mask", "label")
        high = fitted(spec, image, Display()).high if is_fitted else _ERROR_HIGH
        display = self._of_errors.setdefault(name, Display(high=high, color_map="heat"))
        return found | {"b": b, "e": Texels(spec, display, image[..., None], a.frame)}

    def _note(self, side: str, slot: int, values: dict[str, float]) -> None:
        """Note figures of A or B."""
        for name, value in values.items():
            if name == "kernels" or not np.isfinite(value):
                continue
            known = QUANTITIES.get(name)
            words = (known.label, known.unit, known.digits) if known else (name, "", 4)
            empty = dict(zip(("label", "unit", "digits"), words, strict=True)) | {"a": {}, "b": {}}
            self._page["figures"].setdefault(name, empty)[side][slot] = value

    def _write_frame(self, folder: Path, slot: int, shown: dict[str, dict[str, Texels]]) -> None:
        """Write pictures and values of a frame, and note what the page has to know of them."""
        channels, values, first = {}, {}, {}  # values that are those of another picture have its name
        for layer, sides in shown.items():
            of_all = self._page["layers"].setdefault(layer, {})
            for side, one in sides.items():
                of_all.setdefault(side, _described(one))
                Image.fromarray(one.picture(View.background)).save(folder / f"{slot:05d}.{layer}.{side}.png")
                rows, columns, covers = one.on_display()
                count = max(len(of_all[side]["channels"]), 1)
                numbers = np.where(covers[:, None], one.values(rows, columns)[:, :count], np.nan)
                channels[f"{layer}.{side}"] = count
                name, packed = f"{layer}.{side}", _packed(numbers)
                values[name] = f"={first[packed]}" if packed in first else packed
                first.setdefault(packed, name)
            if "e" in sides:
                label = f"mean error: {of_all['a']['label']}, A and B"
                self._note("a", slot, {label: float(np.nanmean(sides["e"].image))})
        (folder / f"{slot:05d}.js").write_text(f"arrived({slot}, {json.dumps(values)});\n", "utf-8")
        self._page["frames"].append({"slot": slot, "text": slot_text(slot, self._plan.n), "pictures": channels})


def _are_alike(a: Texels, b: Texels) -> bool:
    return shown_as(a.spec, a.display)[0] == shown_as(b.spec, b.display)[0]


def _slots(text: str, playback: Playback) -> list[int]:
    """Return the slots of `Plan.frames`. Raises GffeError."""
    if not text:
        return [slot for slot in range(playback.slots) if slot % (playback.n + 1)]
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("..")
        found.update(range(slot_of(first, playback), slot_of(last or first, playback) + 1))
    if not found:
        raise GffeError(f"expected FIRST..LAST, got '{text}'")
    return sorted(found)


def _described(shown: Texels) -> dict[str, Any]:
    """Return what the page has to know of a layer in all frames."""
    spec, display = shown.spec, shown.display
    channels = [display.channel] if display.channel in spec.components else [n for n in spec.components if n != "A"]
    colors = np.rint(255 * color_table(display.color_map)[::17]).astype(int).tolist()
    made = asdict(legend(spec, display))
    if made["kind"] == "wheel":
        colors = [(255, 0, 0), (255, 255, 0), (0, 255, 0), (0, 255, 255), (0, 0, 255), (255, 0, 255), (255, 0, 0)]
        made["ticks"] = [(0, text, ()) for text in ("right", "down", "left", "up", "right")]
    made["colors"] = ", ".join("rgb({} {} {})".format(*color) for color in colors)
    words = {"label": layer_text(spec, display), "view": spec.view, "names": dict(spec.labels)}
    return words | {"channels": channels, "legend": made}


def _packed(numbers: np.ndarray) -> str:
    """Return numbers as little-endian floats, of which the page shows four digits: their bits less those of the
    pixel before, all first bytes, then all second ones …, by zlib, as base64."""
    bits = np.frombuffer(numbers.astype("<f4").tobytes(), "<u4")
    rounded = np.where(np.isfinite(numbers.ravel()), bits + 512 & ~np.uint32(1023), bits)
    steps = np.diff(rounded.astype("<u4").reshape(numbers.shape), axis=0, prepend=np.uint32(0))
    planes = np.ascontiguousarray(steps).view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")


@contextmanager
def _new_folder(place: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary folder that becomes `place` when the block ends. Raises GffeError unless `place` is new or
    empty or, with `overwrite`, an earlier page."""
    try:
        data = place / "data.js"
        old = data.is_file() and data.read_bytes().startswith(_FIRST.encode())
        if place.exists() and not (place.is_dir() and ((old and overwrite) or not any(place.iterdir()))):
            expected = "--overwrite replaces the earlier page" if old else "expected a new or an empty folder"
            raise GffeError(f"--export {place}: exists ({expected})")
        with tempfile.TemporaryDirectory(prefix=".gffe-page-", dir=place.absolute().parent) as staging:
            whole = Path(staging) / "page"
            whole.mkdir()
            yield whole
            if place.exists():
                place.rename(Path(staging) / "before")
            whole.rename(place)
    except OSError as error:
        raise GffeError(f"--export {place}: cannot write ({error.strerror or error})") from None
