"""Make the film, the picture and the tables of docs/tutorial_live.md, of the live Panda3D example.

    python docs/tools/make_live.py [quality] [mistakes] [film]     all, if none is named; needs the extra `examples`

A mistake is made on the way from the renderer to gffe-cl; the picture shows what comes out, the table what `gffe.check`
and `gffe check` find and how far PSNR falls. Nothing may be tuned on this: it shows that conventions matter, not how
good anything is.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pages import DOCS, PICTURES, REPOSITORY, table, write_tables
from PIL import Image, ImageDraw

import gffe_cl as gffe
from gffe_cl.captures.doctor import examine

sys.path.insert(0, str(DOCS / "examples"))
sys.path.insert(0, str(REPOSITORY / "tests" / "helpers"))
from fault_injection import Kept
from panda3d_live import Game

SIZE, RATE = (480, 270), 15
FIRST, FRAMES = 66, 6  # of the stretch that mistakes are made on
CROP = (120, 90, 300, 225)
AHEAD = 0.9  # intervals after the last rendered frame
QUALITY = {"15 → 30 frames/s": "", "30 → 60": "--rate 30 --shown 60", "15 → 30, as a game": "--game"}  # options
FILM_SIZE, FILM_FRAMES = (320, 180), 40
NEAR, FAR = 0.2, 3000  # of the example's lens


@dataclass
class Mistake:
    """Mistake applied to a rendered frame, given the one before (None at first)."""

    name: str
    make: Callable[[gffe.RenderedFrame, gffe.RenderedFrame | None], gffe.RenderedFrame]


def _motion(factor) -> Callable:
    return lambda frame, _: replace(frame, motion=frame.motion * np.float32(factor))


def _device_depth(frame, _) -> gffe.RenderedFrame:
    z = FAR / (FAR - NEAR) * (1 - NEAR / frame.depth)
    return replace(frame, depth=z.astype(np.float32))


def _late_camera(frame, before) -> gffe.RenderedFrame:
    return frame if before is None else replace(frame, camera=before.camera, display_camera=before.camera)


MISTAKES = (
    Mistake("none", lambda frame, _: frame),
    Mistake("vectors lead to the next frame", _motion(-1)),
    Mistake("y of vectors goes up", _motion((1, -1))),
    Mistake("vectors half as long", _motion(0.5)),
    Mistake("depth of the depth buffer", _device_depth),
    Mistake("camera of the frame before", _late_camera),
    Mistake("skin without its old vertices", lambda frame, _: frame),
    Mistake("jitter not in cx, cy", lambda frame, _: frame),
)


class Rigid(Game):
    """The example with a skin whose old vertices are taken to be those of now."""

    def draw(self, now, camera, jittered=None):
        super().draw(now, camera)
        if not self.cut:
            self.kept = self.latest[0], *self.kept[1:]
        return super().draw(now, camera)


class Jittered(Game):
    """The example with a camera that is jittered, while gffe-cl is given the one without jitter."""

    def draw(self, now, camera, jittered=None):
        return super().draw(now, gffe.Jitter(16).camera(camera, self.count))


def stretch(game: Game, kind: type[Game] = Game) -> list[gffe.RenderedFrame]:
    """Return rendered frames that follow each other, of the game as `kind` draws it."""
    game.__class__, game.cut = kind, True
    return [game.render(k / RATE) for k in range(FIRST, FIRST + FRAMES)]


def generated(frames: list[gffe.RenderedFrame], camera: gffe.Camera, time: float) -> np.ndarray:
    """Return the display values of the frame at `time`."""
    pipeline = gffe.Pipeline(gffe.open_device(), *SIZE)
    for frame in frames:
        pipeline.submit(frame)
    return gffe.to_display(pipeline.extrapolate(camera, time).numpy("color"))


def quality() -> None:
    """Write the table of quality, which the example prints."""
    command = [sys.executable, str(DOCS / "examples/panda3d_live.py"), "--offscreen", "--measure", "--frames", "30"]
    rows = []
    for rates, options in QUALITY.items():
        done = subprocess.run([*command, *options.split()], capture_output=True, text=True, check=True)
        found = json.loads(done.stdout.splitlines()[-1])
        figures = (f"{found[name]:.2f}" for name in ("repeat", "gffe", "gffe_network"))
        rows.append((rates, f"`{options}`" if options else "", *figures))
    heads = "frame rates", "options", "repeat the last frame", "GFFE without its network", "GFFE"
    write_tables("tutorial_live.md", {"quality": table(heads, rows)})


def mistakes(game: Game) -> None:
    """Write the picture and the table."""
    time = (FIRST + FRAMES - 1 + AHEAD) / RATE
    right = stretch(game)
    camera = game.look(time)
    truth = gffe.to_display(game.draw(time, camera)[0])
    rigid, jittered = stretch(game, Rigid), stretch(game, Jittered)
    game.__class__ = Game
    tiles, rows = [("really rendered", truth)], []
    for mistake in MISTAKES:
        source = {"skin without its old vertices": rigid, "jitter not in cx, cy": jittered}.get(mistake.name, right)
        frames = [mistake.make(frame, before) for frame, before in zip(source, [None, *source], strict=False)]
        image = generated(frames, camera, time)
        quick, faults = ([f"`{one.name}`" for one in examine(Kept(some)).faults] for some in (frames[1:4], frames))
        tiles.append((f"mistake: {mistake.name}", image))
        found = (", ".join(names) or "nothing" for names in (quick, faults))
        rows.append((mistake.name, f"{gffe.psnr(image, truth):.2f}", *found))
    heads = "mistake", "PSNR, dB", "`gffe.check` finds", "`gffe check` finds"
    write_tables("tutorial_live.md", {"mistakes": table(heads, rows)})
    sheet(tiles).save(PICTURES / "live_mistakes.jpg", quality=88)


def sheet(tiles: list[tuple[str, np.ndarray]]) -> Image.Image:
    """Return labeled parts of images, three in a row, each beside four times its error against the first."""
    left, top, right, bottom = CROP
    width, height = 2 * (right - left), bottom - top
    truth = tiles[0][1]
    made = Image.new("RGB", (3 * width, -(-len(tiles) // 3) * (height + 14)), "white")
    for k, (label, image) in enumerate(tiles):
        x, y = k % 3 * width, k // 3 * (height + 14)
        ImageDraw.Draw(made).text((x + 3, y + 1), label, fill="black")
        pair = np.hstack([part[top:bottom, left:right] for part in (image, 4 * np.abs(image - truth))])
        made.paste(Image.fromarray((255 * np.clip(pair, 0, 1) + 0.5).astype(np.uint8)), (x, y + 14))
    return made


def film(game: Game) -> None:
    """Write the film: left rendered frames at 15 Hz, right generated frames between them, 30 Hz."""
    game.resize(FILM_SIZE)
    shown = []
    for k in range(FILM_FRAMES):
        frame = game.render(k / RATE)
        moment = (k + 0.5) / RATE
        for color in (frame.color, game.generated(moment, game.look(moment))):
            pair = np.hstack([gffe.to_display(frame.color), gffe.to_display(color)])
            shown.append(Image.fromarray((255 * pair + 0.5).astype(np.uint8)))
    first, *others = shown
    path = PICTURES / "live.webp"
    first.save(path, save_all=True, append_images=others, duration=500 / RATE, loop=0, quality=40)
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


def main() -> None:
    asked = set(sys.argv[1:]) or {"quality", "mistakes", "film"}
    if "quality" in asked:
        quality()
    game = Game(SIZE, offscreen=True) if asked & {"mistakes", "film"} else None
    if game and "mistakes" in asked:
        mistakes(game)
    if game and "film" in asked:
        film(game)


if __name__ == "__main__":
    main()
