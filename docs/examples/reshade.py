"""Render anew where the expected error is greatest, and count what that gains.

    python docs/examples/reshade.py                       the eight scenes; weights of the mask were set on these
    python docs/examples/reshade.py room:3 handheld       others; NAME:SEED

A renderer that has time for a few pixels of a new frame asks `expected_error` which. Here a built-in scene is rendered
anew at 5% of the pixels. A line per scene: PSNR of the new frames, with these pixels, and if the pixels with the
greatest true errors were known, dB; the share of the squared error that these pixels held; the expected
root-mean-square error over the true one.
"""

import argparse

import numpy as np

import gffe_cl as gffe
from gffe_cl.captures.scenes import SCENES
from gffe_cl.lab.table.footage import open_subject, parse_subject

FPS, FRAMES, HALF_WAY = 30.0, 7, (0.5,)


def worst_pixels(expected, share):
    """Return (H, W) bool: the pixels above the least level that no more than `share` of them exceed."""
    above = expected.size - np.cumsum(np.bincount(expected.ravel(), minlength=256))
    return expected > np.argmax(above <= share * expected.size)


def measure(device, name, size, share):
    """Return the numbers of a scene's line, means over its new frames, and print them."""
    footage = open_subject(parse_subject(name, size, FRAMES, FPS, HALF_WAY), device)
    pipeline = gffe.Pipeline(device, *size, gffe.Options(expected_error=True), fps=FPS)
    pipeline.exposure, found = footage.exposure, []
    for shot in footage.shots():
        pipeline.submit(shot.frame)
        for moment in shot.moments:
            made = pipeline.extrapolate(moment.camera, moment.time)
            expected = made.numpy("expected_error")
            color, truth = (gffe.to_display(c, footage.exposure) for c in (made.numpy("color"), moment.truth))
            again = worst_pixels(expected, share)
            new = np.where(again[..., None], truth, color)  # what a renderer would shade there
            squared = np.square(color - truth).mean(-1)
            known = np.sort(squared, axis=None)[: -int(share * squared.size)].sum() / squared.size
            held = squared[again].sum() / squared.sum()
            ratio = np.sqrt(np.square(expected / 1020.0).mean() / squared.mean())
            found.append((gffe.psnr(color, truth), gffe.psnr(new, truth), -10 * np.log10(known), held, ratio))
    line = np.mean(found, axis=0)
    print(f"{name:14}{line[0]:8.2f}{line[1]:8.2f}{line[2]:8.2f}{line[3]:8.2f}{line[4]:8.2f}", flush=True)
    return line


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--size", default="480x270")
    parser.add_argument("--share", type=float, default=0.05)
    given = parser.parse_args()
    chosen = tuple(map(int, given.size.split("x")))
    print(f"{'scene':14}{'new':>8}{'again':>8}{'known':>8}{'held':>8}{'ratio':>8}")
    lines = [measure(gffe.open_device(), name, chosen, given.share) for name in given.scenes]
    mean = np.mean(lines, axis=0)
    print(f"{'mean':14}" + "".join(f"{value:8.2f}" for value in mean))
