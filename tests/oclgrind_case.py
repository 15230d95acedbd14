"""Runs every kernel once at 64×48; meant to be started under Oclgrind (see test_oclgrind.py)."""

import sys

from test_twins import run

from gffe_cl.device import open_device
from gffe_cl.pipeline import Options

WIDTH, HEIGHT = 64, 48


def stages(device, int64):
    """All kernels of the pipeline, in the path with 64-bit atomics or the one without."""
    for options in (Options(history=3, order=2, shading_inputs=True), Options(hole_filling="push-pull")):
        pipeline, *_, made = run(device, WIDTH, HEIGHT, options, int64, target=(WIDTH - 3, HEIGHT + 5))
        made.numpy("color")
        pipeline.present().numpy("motion")


def scene(device):
    from gffe_cl.scenes import SCENES, SceneRenderer, load_scene

    for name in SCENES:
        built = load_scene(name)
        renderer = SceneRenderer(device, built, 32, 18, samples=2)
        camera = built.camera(0.1, 32, 18)
        renderer.render(0.1, camera, 0.0, built.camera(0.0, 32, 18)).numpy()


if __name__ == "__main__":
    opened = open_device()
    assert opened.info.platform == "Oclgrind", opened
    case = sys.argv[1]
    if case == "scene":
        scene(opened)
    else:
        stages(opened, case == "int64")
    print("finished", case)
