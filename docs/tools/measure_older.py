"""Measure what frames before t could show of what t hides, if motion were known exactly.

    python docs/tools/measure_older.py                      the situations with bars, of `use` tuned
    python docs/tools/measure_older.py bars:0 balls:71      others of the corpus

A line per sequence, for holes that lie on movers and for others: their share of the area and of the squared error; the
share of their pixels whose surface one of the eight frames before t shows in all four taps of a sample; dB gained if
each took the color of the newest such frame.
"""

from __future__ import annotations

import argparse

import numpy as np
from corpus import SIZE, corpus_lines, rendered
from quality_side import camera_of

import gffe_cl as gffe
from gffe_cl.captures.scenes import SceneRenderer
from gffe_cl.lab.metrics import same_surface
from gffe_cl.lab.table.footage import moving_pixels, pixel_centers
from gffe_cl.lab.table.methods import sample, taps

MOST_BACK = 8  # frames before t
TUNED = "bars:0", "railings:0", "balls:0", "rotors:0", "first_person:0"


def seen_in(frame, image, color, depth):
    """Return an image's surfaces as a frame shows them, (H, W, 3) float32; which taps of a sample do, (4, H, W) bool;
    and where it is on screen, (H, W). `frame` is what `image.motion` and `image.other_position` refer to."""
    place = pixel_centers(*SIZE[::-1]) + image.motion
    z = np.where(np.isinf(image.depth), np.inf, image.other_position[..., 2])
    inside = (place >= 0).all(-1) & (place < SIZE).all(-1)
    shows = inside & same_surface(taps(depth[frame], place), z)
    return sample(color[frame].astype(np.float32), place)[0], shows, inside


def measure(line, device):
    """Print the line of a sequence."""
    scene = line.scene()
    renderer = SceneRenderer(device, scene, *SIZE)
    with np.load(rendered(line, device)) as stored:
        s = dict(stored)
    cameras = [camera_of(flat) for flat in s["camera"]]
    pipeline = gffe.Pipeline(device, *SIZE, gffe.Options(shading_correction=False), fps=float(s["fps"]))
    pipeline.exposure, total, sums = scene.exposure, 0.0, np.zeros((2, 4))
    for k, camera in enumerate(cameras):
        time = float(s["time"][k])
        pipeline.submit(gffe.RenderedFrame(s["color"][k], s["depth"][k], s["motion"][k], camera, time, reset=k == 0))
        for moment in np.flatnonzero(s["after"] == k):
            at, new = float(s["truth_time"][moment]), camera_of(s["truth_camera"][moment])
            made, truth = pipeline.extrapolate(new, at).numpy("color"), s["truth"][moment]

            def error(color, truth=truth):
                shown = gffe.to_display(color, scene.exposure) - gffe.to_display(truth, scene.exposure)
                return np.square(shown).mean(-1)

            now = error(made)
            image = renderer.render(at, new, time, camera).numpy()
            _, shows, inside = seen_in(k, image, s["color"], s["depth"])
            hidden = inside & ~shows.any(0)
            moving = moving_pixels(image.motion, image.depth, new, camera)
            left, gain, found = hidden.copy(), np.zeros_like(now), np.zeros_like(hidden)
            for before in range(k - 1, max(k - MOST_BACK, 0) - 1, -1):
                image = renderer.render(at, new, float(s["time"][before]), cameras[before]).numpy()
                color, shows, _ = seen_in(before, image, s["color"], s["depth"])
                there = left & shows.all(0)
                gain[there], found, left = (now - error(color))[there], found | there, left & ~there
            total += now.sum()
            for row, part in zip(sums, (hidden & moving, hidden & ~moving), strict=True):
                row += part.sum(), now[part].sum(), (found & part).sum(), gain[part].sum()
    for kind, (area, wrong, found, gain) in zip(("on movers", "others"), sums, strict=True):
        share, seen = area / (len(s["after"]) * SIZE[0] * SIZE[1]), found / max(area, 1)
        gained = f"gain {-10 * np.log10(1 - gain / total):+.3f} dB"
        print(
            f"{line.name:16}{kind:10} area {share:7.2%}, error {wrong / total:6.1%}, seen {seen:6.1%}, {gained}",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="*", default=TUNED)
    chosen = parser.parse_args().sequences
    for one in corpus_lines():
        if one.name in chosen:
            measure(one, gffe.open_device())
