"""Descriptions of engines' buffers: what each SDK has of a camera that turns and moves becomes our conventions."""

import math
from dataclasses import fields, replace

import numpy as np
import pyopencl as cl
import pytest
from synthetic import camera

from gffe_cl import FrameFormat, GffeError, Options, Pipeline, RenderedFrame
from gffe_cl.engine.frame.frame_format import conversion

W, H = 40, 24
NEAR, FAR = 0.25, 60.0
NOW, BEFORE = camera(W, H, (0.5, -0.2, 0.7), 0.1, -0.04, 0.06), camera(W, H, (0.1, 0.1, 0), -0.06, 0.03)
JITTER, JITTER_BEFORE = (0.31, -0.44), (-0.27, 0.12)
NONE = (0.0, 0.0)


def projection(view, far, inverted):
    """Direct3D's matrix for column vectors: view axes x right, y up, z forward; y up on the screen; depth 0 … 1."""
    a, b = (1.0, -NEAR) if math.isinf(far) else (far / (far - NEAR), -far * NEAR / (far - NEAR))
    if inverted:
        a, b = 1 - a, -b
    x, y = 2 * view.fx / W, 2 * view.fy / H
    return np.array([[x, 0, 2 * view.cx / W - 1, 0], [0, y, 1 - 2 * view.cy / H, 0], [0, 0, a, b], [0, 0, 1, 0]])


def clip(world, view, far=FAR, inverted=False, jitter=NONE):
    """Normalized device coordinates (…, 3) of world points, float64; jitter as the SDKs' guides apply it."""
    y_up = np.diag([1.0, -1, 1, 1])
    translation = np.eye(4)
    translation[:2, 3] = 2 * jitter[0] / W, -2 * jitter[1] / H
    matrix = translation @ projection(view, far, inverted) @ y_up @ view.world_to_view
    homogeneous = np.concatenate([world, np.ones((*world.shape[:-1], 1))], -1) @ matrix.T
    return homogeneous[..., :3] / homogeneous[..., 3:]


class World:
    """World points that the geometry's pixels show, where they were before, and what our conventions say of them."""

    def __init__(self, jitter):
        rng = np.random.default_rng(4)
        y, x = np.mgrid[:H, :W] + 0.5
        self.depth = rng.uniform(1, 50, (H, W))
        self.moves = rng.random((H, W)) < 0.4
        shifted = replace(NOW, cx=NOW.cx + jitter[0], cy=NOW.cy + jitter[1])
        self.now = shifted.unproject(np.stack([x, y], -1), self.depth)
        self.before = self.now - np.where(self.moves[..., None], rng.normal(0, 0.3, (H, W, 3)), 0)
        self.motion = BEFORE.project(self.before)[0] - NOW.project(self.now)[0]

    def ndc(self, **how):
        """Normalized device coordinates here and before, y up."""
        before = how | {"jitter": how.get("jitter_before", NONE)}
        del before["jitter_before"]
        here = {name: value for name, value in how.items() if name != "jitter_before"}
        return clip(self.now, NOW, **here), clip(self.before, BEFORE, **before)


def fsr_inverted(world):
    """Reversed infinite depth, jittered vectors in texture coordinates."""
    here, before = world.ndc(far=math.inf, inverted=True, jitter=JITTER, jitter_before=JITTER_BEFORE)
    vectors = (before - here)[..., :2] * (0.5, -0.5)
    flags = 1 << 2 | 1 << 3 | 1 << 4
    made = FrameFormat.fsr3(renderSize=(W, H), motionVectorScale=(W, H), cameraNear=NEAR, cameraFar=FAR, flags=flags)
    return made, here[..., 2], vectors


def fsr_plain(world):
    """Finite depth with swapped planes, vectors in pixels without jitter."""
    here, before = world.ndc(jitter_before=NONE)
    made = FrameFormat.fsr3(renderSize=(W, H), cameraNear=FAR, cameraFar=NEAR)
    return made, here[..., 2], (before - here)[..., :2] * (W / 2, -H / 2)


def streamline(world):
    """Vectors in pixels, jittered; depth not inverted."""
    here, before = world.ndc(jitter=JITTER, jitter_before=JITTER_BEFORE)
    made = FrameFormat.streamline(
        mvecScale=(1 / W, 1 / H),
        cameraNear=NEAR,
        cameraFar=FAR,
        depthInverted=False,
        motionVectorsJittered=True,
        motionVectorsInvalidValue=float(np.finfo(np.float32).max),
    )
    return made, here[..., 2], (before - here)[..., :2] * (W / 2, -H / 2)


def streamline_movers(world):
    """Only movers have vectors, a fraction of the image; others hold 0."""
    here, before = world.ndc(inverted=True, jitter_before=NONE)
    made = FrameFormat.streamline(
        mvecScale=(1, 1), cameraNear=NEAR, cameraFar=FAR, depthInverted=True, cameraMotionIncluded=False
    )
    vectors = (before - here)[..., :2] * (0.5, -0.5)
    return made, here[..., 2], np.where(world.moves[..., None], vectors, 0)


def xess_ndc(world):
    """Vectors in normalized device coordinates, jittered; depth inverted; the matrix is for row vectors."""
    here, before = world.ndc(inverted=True, jitter=JITTER, jitter_before=JITTER_BEFORE)
    matrix = projection(NOW, FAR, True).T.ravel().tolist()
    made = FrameFormat.xess(projectionMatrix=matrix, initFlags=1 << 0 | 1 << 3 | 1 << 4, motionVectorScaleX=-1)
    return made, here[..., 2], (before - here)[..., :2] * (-1, 1)


def xess_pixels(world):
    """Vectors in pixels from the current frame to the previous one; infinite depth, not inverted."""
    here, before = world.ndc(far=math.inf, jitter_before=NONE)
    made = FrameFormat.xess(projectionMatrix=projection(NOW, math.inf, False))
    return made, here[..., 2], (before - here)[..., :2] * (W / 2, -H / 2)


def openxr(world):
    """Vectors since the previous frame in Vulkan's coordinates, scaled and offset; infinite depth, reversed, in a part
    of the range."""
    here, before = world.ndc(far=math.inf, inverted=True, jitter_before=NONE)
    scale, offset = np.array([0.5, -2.0]), np.array([0.125, -0.25])
    made = FrameFormat.openxr(
        motionVectorScale=(*scale, 1, 0),
        motionVectorOffset=(*offset, 0, 0),
        minDepth=0.2,
        maxDepth=0.9,
        nearZ=math.inf,
        farZ=NEAR,
        layerFlags=1,
    )
    vectors = (here - before)[..., :2] * (1, -1)
    return made, 0.2 + 0.7 * here[..., 2], (vectors - offset) / scale


def without_camera(world):
    """No SDK's: vectors from the previous frame, from which the camera's motion was subtracted."""
    static = BEFORE.project(world.now)[0] - NOW.project(world.now)[0]
    made = FrameFormat(motion_direction="from_previous", camera_motion="excluded")
    return made, world.depth, static - world.motion


ENGINES = {
    case.__name__: (case, jittered)
    for jittered, cases in (
        (True, (fsr_inverted, streamline, xess_ndc)),
        (False, (fsr_plain, streamline_movers, xess_pixels, openxr, without_camera)),
    )
    for case in cases
}


@pytest.mark.parametrize("engine", ENGINES)
def test_engines_buffers_become_our_conventions(device, engine):
    """Arrays of float: within rounding of what NumPy computes from world points, in float64."""
    case, jittered = ENGINES[engine]
    world = World(JITTER if jittered else NONE)
    made, depth, vectors = case(world)
    pipeline = Pipeline(device, W, H, Options(shading_correction=False), format=made)
    color = np.zeros((H, W, 3), np.uint8)
    for k, (view, jitter) in enumerate(((BEFORE, JITTER_BEFORE), (NOW, JITTER))):
        pipeline.submit(
            RenderedFrame(
                color,
                depth.astype(np.float32),
                vectors.astype(np.float32),
                view,
                k / 30,
                reset=k == 0,
                geometry_jitter=jitter if jittered else NONE,
            )
        )
    found, moved = np.empty((H, W), np.float32), np.empty((H, W, 2), np.float32)
    for array, buffer in ((found, pipeline.frames.current.depth), (moved, pipeline.frames.current.motion)):
        cl.enqueue_copy(device.queue, array, buffer)
    # Depth of planes 0.25 and 60 units away in 24 bits of a mantissa: 2^-24 · z / near, some 3e-5 at 50 units.
    np.testing.assert_allclose(found, world.depth, rtol=5e-5)
    # Vectors up to a few hundred pixels in float; the camera's part follows from that depth.
    np.testing.assert_allclose(moved, world.motion, rtol=2e-5, atol=2e-3)
    assert not pipeline.bad_pixels


def test_engines_types_are_converted_in_device_buffers(device):
    """Half vectors of four channels, 16-bit color, 24-bit depth beside a stencil, in buffers on the device."""
    world, rng = World(NONE), np.random.default_rng(1)
    made, depth, vectors = openxr(world)
    made = replace(made, color_type="unorm16", depth_type="unorm24", motion_channels=4)
    color = rng.integers(0, 65536, (H, W, 4), dtype=np.uint16)
    stencil = rng.integers(0, 256, (H, W), dtype=np.uint32) << 24
    depth = np.round(depth * 0xFFFFFF).astype(np.uint32) | stencil
    motion = np.concatenate([vectors, rng.normal(size=(H, W, 2))], -1).astype(np.float16)
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    buffers = [cl.Buffer(device.context, flags, hostbuf=array) for array in (color, depth, motion)]
    pipeline = Pipeline(device, W, H, Options(shading_correction=False), format=made)
    pipeline.submit(RenderedFrame(*buffers, NOW, 0.0, reset=True))
    shown = pipeline.present()
    np.testing.assert_allclose(shown.numpy("color"), color[..., :3] / 65535, rtol=1e-3, atol=1e-7)
    np.testing.assert_allclose(shown.numpy("depth"), world.depth, rtol=1e-3)  # steps of 2^-24 / 0.7 · z² / near
    steps = np.abs(vectors) * 2.0**-11 * (0.5 * W / 2, 2 * H / 2) + 1e-3
    assert (np.abs(shown.numpy("motion") - world.motion) <= steps).all()


def test_no_conversion_of_our_own_buffers(device):
    """Device buffers that a description leaves as they are are used in place; those of another type are not."""
    pipeline = Pipeline(device, W, H, Options(shading_correction=False), format=FrameFormat())
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    arrays = [np.ones((H, W, n), dtype) for n, dtype in ((4, np.float16), (1, np.float32), (2, np.float32))]
    buffers = [cl.Buffer(device.context, flags, hostbuf=array) for array in arrays]
    pipeline.submit(RenderedFrame(*buffers, NOW, 0.0, reset=True))
    assert pipeline.frames.current.buffers == tuple(buffers)
    pipeline.format = FrameFormat(motion_unit="uv")
    pipeline.submit(RenderedFrame(*buffers, NOW, 0.1))
    assert pipeline.frames.current.color is buffers[0] and pipeline.frames.current.depth is not buffers[1]
    moved = np.empty((H, W, 2), np.float32)
    cl.enqueue_copy(device.queue, moved, pipeline.frames.current.motion)
    assert np.isnan(moved).all()  # a whole image and more: no pixel moves so far
    assert pipeline.bad_pixels.long == W * H


def test_invalid_values_are_unknown_and_not_bad(device):
    """The value that stands for unwritten vectors, in the precision of the buffer: 65504 in half, −1 in UV."""
    for value, dtype in ((65504.0, np.float16), (-1.0, np.float32), (0.1, np.float16)):
        made = FrameFormat(motion_unit="uv", motion_invalid=value)
        pipeline = Pipeline(device, W, H, Options(shading_correction=False), format=made)
        motion = np.full((H, W, 2), 0.01, dtype)
        motion[:3] = value
        motion[3, :, 0] = value if abs(value) < 1 else 0.01  # one component alone is a vector
        pipeline.submit(RenderedFrame(np.ones((H, W, 3), np.float16), np.ones((H, W)), motion, NOW, 0.0))
        moved = np.empty((H, W, 2), np.float32)
        cl.enqueue_copy(device.queue, moved, pipeline.frames.current.motion)
        assert np.isnan(moved[:3]).all() and np.isfinite(moved[3:]).all() and not pipeline.bad_pixels


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"depth": "device"}, "near_z and far_z greater than 0"),
        ({"depth": "device", "near_z": 1, "far_z": 1}, "must differ"),
        ({"depth": "logarithmic", "near_z": -1, "far_z": 1}, "logarithmic depth needs near_z and far_z of 0 or more"),
        ({"depth": "logarithmic", "near_z": 1, "far_z": math.inf}, "far_z of logarithmic depth must be a finite"),
        ({"depth": "logarithmic", "near_z": 1e-30, "far_z": 9}, "times apart"),
        ({"depth": "linear", "near_z": 1, "far_z": math.inf}, "far_z of linear depth must be a finite"),
        ({"depth": "distance", "near_z": 1, "far_z": math.inf}, "far_z of distance depth must be a finite"),
        ({"depth": "device", "near_z": 1, "far_z": 2, "depth_scale": 0.01}, "depth_scale must be 1 with device depth"),
        ({"camera_motion": "movers_only"}, "needs motion_invalid"),
    ],
)
def test_wrong_descriptions_are_refused(wrong, text):
    with pytest.raises(GffeError, match="format: ") as refused:
        FrameFormat(**wrong)
    assert text in str(refused.value) and "\n" not in str(refused.value)


def still_and_mover(size, k, jitter=NONE, color_size=None):
    """Depth and motion at the centers of pixels of an image of `size`, without jitter in the vectors, and color of
    `color_size` or none. A bright square moves by (4, 1.6) pixels of 160×96 in front of a wall; each has its texture.
    """
    width, height = size
    scale = np.array([160 / width, 96 / height])

    def seen(size, jitter):
        x, y = np.meshgrid(*((np.arange(n) + 0.5 - j) * m / n for n, j, m in zip(size, jitter, (160, 96), strict=True)))
        return x, y, (np.abs(x - 60 - 4 * k) < 22) & (np.abs(y - 40 - 1.6 * k) < 17)

    x, y, in_front = seen(size, jitter)
    depth = np.where(in_front, 3.0, 9 + y / 48)
    motion = np.where(in_front[..., None], np.array([-4, -1.6]) / scale, 0)
    if color_size is None:
        return None, depth.astype(np.float32), motion.astype(np.float32)
    x, y, in_front = seen(color_size, NONE)
    texture = 1 + 0.3 * np.sin((x - 4 * k * in_front) / 3) * np.sin((y - 1.6 * k * in_front) / 4)
    return (np.where(in_front, 0.7, 0.2) * texture)[..., None].repeat(3, -1), depth, motion


def test_edges_of_smaller_geometry_follow_color(device):
    """Depth and motion of half the size and less, by another size in every frame, are those of the full size but for
    few pixels; nothing is a reset, and static pixels stay static."""
    size = 160, 96
    pipeline = Pipeline(device, *size, Options(shading_correction=False))
    view = camera(*size)
    shares = []
    sizes = (80, 48), (107, 64), (61, 37), (160, 96), (80, 33)
    for k, (geometry, jitter) in enumerate(zip(sizes, (NONE, (0.3, -0.4), (-0.2, 0.1), NONE, (0, 0.25)), strict=True)):
        color, full_depth, full_motion = still_and_mover(size, k, color_size=size)
        _, depth, motion = still_and_mover(geometry, k, jitter)
        how = {"reset": k == 0, "geometry_jitter": jitter, "geometry_size": geometry}
        pipeline.submit(RenderedFrame(color.astype(np.float16), depth, motion, view, k / 30, **how))
        found, moved = np.empty(size[::-1], np.float32), np.empty((*size[::-1], 2), np.float32)
        for array, buffer in ((found, pipeline.frames.current.depth), (moved, pipeline.frames.current.motion)):
            cl.enqueue_copy(device.queue, array, buffer)
        wrong = (np.abs(found / full_depth - 1) > 0.01) | (np.abs(moved - full_motion).max(-1) > 0.01)
        y, x = (np.arange(n) * m // n for n, m in zip(size[::-1], geometry[::-1], strict=True))
        repeated = np.abs(depth[np.ix_(y, x)] / full_depth - 1) > 0.01
        shares.append((wrong.mean(), repeated.mean()))
    worst, by_repeating = np.max(shares, 0)
    assert worst < 0.002 and by_repeating > 0.005
    assert len(pipeline.frames.times) == len(sizes) and not pipeline.is_cut
    dynamic = pipeline.stages["history"].read("dynamic_mask") != 0
    assert (dynamic != (full_motion != 0).any(-1)).mean() < 0.005


def test_sizes_that_cannot_be_are_refused(device):
    made = FrameFormat.fsr3(renderSize=(20, 12), displaySize=(40, 24), cameraNear=1)
    pipeline = Pipeline(device, 40, 24, format=made)
    with pytest.raises(GffeError, match=r"color is 20×12 \(expected the render size 40×24\)"):
        Pipeline(device, 40, 24, format=replace(made, color_size=(20, 12)))
    for wrong in ((12, 12), (40, 7), (41, 24), (20, 25)):
        with pytest.raises(GffeError, match=f"geometry is {wrong[0]}×{wrong[1]} and color 40×24"):
            pipeline.format = replace(made, geometry_size=wrong)
    pipeline.format = replace(made, geometry_size=(13, 8))  # 3.08 and 3 times smaller: 40 / 3 rounded down
    frame = RenderedFrame(np.ones((24, 40, 3), np.uint8), np.ones((12, 20)), np.zeros((12, 20, 2)), NOW, 0.0)
    with pytest.raises(GffeError, match=r"depth must have shape \(8, 13\)"):
        pipeline.submit(frame)
    pipeline.submit(replace(frame, geometry_size=(20, 12)))
    with pytest.raises(GffeError, match="geometry_size must be"):
        pipeline.submit(replace(frame, geometry_size=20))
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    pipeline.format = FrameFormat()
    buffers = [cl.Buffer(device.context, flags, hostbuf=np.ones((12, 20, n), np.float32)) for n in (8, 1, 2)]
    given = RenderedFrame(*buffers, NOW, 1.0, geometry_size=(20, 13))
    with pytest.raises(GffeError, match=r"depth buffer must hold 1040 bytes \(20×13\)"):
        pipeline.submit(given)
    with pytest.raises(GffeError, match="fsr3: motion vectors at display resolution 40×24"):
        FrameFormat.fsr3(renderSize=(20, 12), displaySize=(40, 24), cameraNear=1, flags=1 << 1)


def test_wrong_frames_are_refused(device):
    pipeline = Pipeline(device, W, H, Options(shading_correction=False), format=FrameFormat())
    good = RenderedFrame(np.ones((H, W, 3), np.uint8), np.ones((H, W)), np.zeros((H, W, 2)), NOW, 0.0)
    for wrong, text in (
        ({"color": np.ones((H, W, 3), np.int32)}, "color must be of type uint16, uint8"),
        ({"depth": np.ones((H, W), np.uint8)}, "depth must be of type float32, uint16, uint32"),
        ({"motion": np.zeros((H, W, 2), np.int64)}, "motion must be of type"),
        ({"motion": None}, "motion is missing"),
        ({"geometry_jitter": (640, 0)}, "geometry_jitter must be in pixels"),
        ({"geometry_jitter": 1}, "geometry_jitter must have shape"),
    ):
        with pytest.raises(GffeError, match=text):
            pipeline.submit(replace(good, **wrong))
    with pytest.raises(GffeError, match="must be a FrameFormat or None"):
        pipeline.format = "FSR"


def test_text_and_back():
    """Every field, none of them at its default: planes and a scale of depth exclude one another."""
    made = FrameFormat(
        color_size=(40, 24),
        geometry_size=(20, 12),
        rows="up",
        color_type="unorm8",
        color_channels=3,
        color_encoding="srgb",
        depth_type="unorm24",
        depth="device",
        near_z=math.inf,
        far_z=0.1,
        depth_range=(0.2, 0.9),
        motion_type="snorm16",
        motion_channels=4,
        motion_scale=(2, -3),
        motion_offset=(0.1, 0),
        motion_unit="ndc",
        motion_direction="from_previous",
        motion_y="up",
        motion_dilated=True,
        motion_jittered=True,
        motion_invalid=0.0,
        camera_motion="movers_only",
    )
    scaled = FrameFormat(depth="distance", depth_scale=0.01)
    assert FrameFormat.from_json(scaled.to_json()) == scaled
    given = made.to_json()
    assert given.keys() | scaled.to_json().keys() == {field.name for field in fields(FrameFormat)}
    assert given["near_z"] == "infinity"
    assert FrameFormat.from_json(given) == made and FrameFormat.from_json({}) == FrameFormat()
    with pytest.raises(GffeError, match="unknown field 'colour'"):
        FrameFormat.from_json({"colour": 1})


def test_numbers_of_integers_are_exact_at_both_ends():
    """Depth of 24 bits: the far end is subtracted before anything is rounded."""
    made = FrameFormat(depth="device", near_z=0.1, far_z=math.inf)
    numbers = conversion(made, (W, H), {"color": None, "depth": "unorm24", "motion": None}, {"color": 4, "motion": 2})
    factor, origin, addend, sky = numbers["given_depth"]
    assert origin == sky == 0xFFFFFF and addend == 0 and factor == pytest.approx(-10 / 0xFFFFFF, rel=1e-12)
