"""Blocks that are warped backward: results against splatting everything."""

import numpy as np
import pytest
from synthetic import Rect, Rects, camera
from twin_cases import SCENE, frames

from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.buffers import BY_CRACK_CLOSING, BY_WARP
from gffe_cl.engine.stages.warp import COPIED

_LINEAR_MOST = constants("backward_blocks.cl")["LINEAR_MOST"]  # pixels

# What lies before a wall and hides parts of it, moves or stands still; tilted by the cameras of `frames`.
WALLS = Rects([Rect((0, 0, 12), (9, 6), frequency=0.3), Rect((0.8, 0.3, 7), (1.2, 1.0), frequency=1, tint=(4, 5, 90))])
SIZES = [((160, 96), None), ((131, 75), (160, 96)), ((160, 96), (93, 50)), ((9, 7), None)]


def both(device, source, options, size, target, to, time):
    """The last frame with blocks and without, the pipelines too."""
    pipelines = [
        Pipeline(device, *(target or size), Options(**options, blocks=blocks), render_size=size)
        for blocks in (True, False)
    ]
    for frame in source:
        for pipeline in pipelines:
            pipeline.submit(frame)
    for pipeline in pipelines:
        pipeline.extrapolate(to, time)
    return pipelines


def assert_same_picture(with_blocks, without):
    """Holes are equal, and nearly so most pixels that the warp makes: blocks are linear, and at edges whose sides
    hardly move apart the other side may be shown, by as little as these sides move apart."""
    read = [
        {spec.name: p.board.frame.read(spec.name) for spec in p.board.frame.buffers} for p in (with_blocks, without)
    ]
    assert np.array_equal(read[0]["disoccluded"], read[1]["disoccluded"])
    labels = [np.where(r["filled_by"] == BY_CRACK_CLOSING, BY_WARP, r["filled_by"]) for r in read]
    assert np.array_equal(*labels)
    with np.errstate(invalid="ignore"):
        other = ~np.isclose(read[0]["depth"], read[1]["depth"], rtol=0.02)
    other |= read[0]["dynamic"] != read[1]["dynamic"]
    assert other.mean() < 0.015, f"{other.sum()} pixels"
    motion = np.abs(read[0]["motion"] - read[1]["motion"]).max(-1)[~other]
    assert motion.max() < 4 * _LINEAR_MOST and (motion > _LINEAR_MOST).mean() < 0.01
    color = [np.minimum(r["color"][..., :3].astype(np.float32), 1) for r in read]
    differ = np.abs(color[0] - color[1]).max(-1)[~other] > 0.01
    assert differ.mean() < 2e-3, f"{differ.sum()} pixels"


@pytest.mark.parametrize(("size", "target"), SIZES, ids=["plain", "larger", "smaller", "tiny"])
@pytest.mark.parametrize("scene", [SCENE, WALLS], ids=["movers", "walls"])
def test_results_with_and_without_blocks(device, scene, size, target):
    seen = list(frames(*size, spoil=False, scene=scene))
    to = camera(*(target or size), (0.35, 0.07, 0.6), 0.075, 0.045, 0.035)
    pipelines = both(device, seen, {}, size, target, to, seen[-1].time + 0.02)
    if min(size) > 50:
        assert 0.1 < pipelines[0].stages["backward_blocks"].read("block_class").mean() < 0.95
    assert not pipelines[1].stages["backward_blocks"].read("block_class").any()
    assert_same_picture(*pipelines)


def test_the_same_camera_gives_the_same_picture(device):
    """Bit for bit, of what stands still."""
    size = (160, 96)
    still = [frame for frame in frames(*size, spoil=False, scene=WALLS)][:1] * 2
    for k, frame in enumerate(still):
        still[k] = type(frame)(frame.color, frame.depth, frame.motion * 0, frame.camera, k / 30, reset=k == 0)
    pipeline = both(device, still, {}, size, None, still[0].camera, 1.5 / 30)[0]
    assert (pipeline.stages["backward_blocks"].read("block_class") == COPIED).mean() > 0.9  # edges of depth, too
    color = pipeline.board.frame.read("color")[..., :3]
    assert np.array_equal(color, still[0].color[..., :3].astype(np.float16))
    assert np.array_equal(pipeline.board.frame.read("depth"), still[0].depth)
    assert not pipeline.board.frame.read("motion").any()


@pytest.mark.parametrize("name", ["forest", "street", "factory"])
def test_built_in_scenes(device, name):
    scene = load_scene(name)
    rendered = SceneFrames(SceneRenderer(device, scene, 320, 180))
    seen = list(rendered.sequence(3, 30.0))
    time = seen[-1].time + 0.5 / 30
    pipelines = both(device, seen, {"shading_correction": False}, (320, 180), None, rendered.display_camera(time), time)
    assert pipelines[0].stages["backward_blocks"].read("block_class").mean() > 0.1
    assert_same_picture(*pipelines)


def test_blocks_with_an_affine_flow(device):
    """A camera that hardly moves: the inverse of a block's flow is exact, and the picture that of splatting."""
    size = (160, 96)
    seen = list(frames(*size, spoil=False, scene=WALLS))
    last = seen[-1].camera
    to = type(last)(last.world_to_view.copy(), last.fx, last.fy, last.cx + 0.37, last.cy - 0.21)
    # Without stages that lend memory, so that nothing takes the place of what the blocks say.
    options = {"levels": 0, "acceleration": False, "soft_silhouettes": False, "shading_correction": False}
    pipelines = both(device, seen, options, size, None, to, seen[-1].time + 0.02)
    backward = pipelines[0].stages["backward_blocks"].read("block_class") == 1
    assert backward.mean() > 0.7
    assert_same_picture(*pipelines)
