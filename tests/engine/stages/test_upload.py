"""NumPy arrays on their way to the device: the bits of the twin, and its counts of bad pixels."""

import numpy as np
import pyopencl as cl
import pytest
import twins
from device_arrays import of_arrays
from synthetic import camera

from gffe_cl import FrameFormat, Options, Pipeline, RenderedFrame
from gffe_cl.captures.sequence.encoding import nearest_motion
from gffe_cl.engine.frame.frame_format import (
    CAMERA_MOTIONS,
    COLOR_TYPES,
    DEPTH_TYPES,
    DEPTHS,
    MOTION_TYPES,
    TYPES,
    conversion,
)
from gffe_cl.engine.frame.rendered_frame import BadPixels, host_arrays
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.base import Board, Step
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.frame_block import reprojection
from gffe_cl.engine.stages.upload import Upload

SIZES = [(1, 1), (3, 70), (37, 21), (64, 4), (249, 5)]  # one more than eight lanes have in a run


@pytest.fixture(params=[8, 1])
def lanes(request, device, monkeypatch):
    monkeypatch.setitem(device.__dict__, "lanes", request.param)


@pytest.fixture(params=[True, False], ids=["in place", "copied"])
def stage_of(request, device, lanes):
    """Makes the stage for a size."""

    def made(size):
        stage = Upload(Board(device, Sizes(size, size)))
        stage._in_place = request.param and device.info.kind == "cpu"
        return stage

    return made


def colors(rng, size, channels, dtype):
    """Of all magnitudes and signs, with values that half does not hold."""
    shape = (size[1], size[0], channels)
    values = rng.normal(0, 1, shape) * 10.0 ** rng.uniform(-9, 5.5, shape)
    share = rng.random(shape)
    for k, value in enumerate((np.nan, np.inf, -np.inf, -0.0, 65504, 65510, 65519.99, -65520)):
        values[(share > 0.01 * k) & (share < 0.01 * k + 0.01)] = value
    with np.errstate(over="ignore"):
        return values.astype(dtype)


def geometry(rng, size):
    depths = [1, 1, 1e-40, -1, 0, np.nan, np.inf, -np.inf, 1e37, 2e37, np.finfo(np.float32).max]
    depth = rng.choice(depths, size[::-1]).astype(np.float32)
    vectors = [1, 5, 7, -size[0], size[1], 1e30, np.nan, np.inf, -np.inf]
    return depth, rng.choice(vectors, (*size[::-1], 2)).astype(np.float32)


def taken(stage, frame):
    """What lies on the device then."""
    on_device = DeviceFrame.allocate(stage.device, stage.sizes.source, frame.camera, frame.camera, frame.time)
    stage.take(host_arrays(frame), on_device)
    shapes = ((4,), np.float16), ((), np.float32), ((2,), np.float32)
    arrays = [np.empty((*np.shape(frame.depth), *channels), dtype) for channels, dtype in shapes]
    for array, buffer in zip(arrays, on_device.buffers, strict=True):
        cl.enqueue_copy(stage.device.queue, array, buffer)
    return arrays


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_upload_equals_its_twin(device, stage_of, size, dtype):
    """All forms of arrays that are taken as they are, one after another in the same stage."""
    stage, rng, view = stage_of(size), np.random.default_rng(size), camera(*size)
    for channels in (3, 4):
        for shown in (channels, 3):  # the first three of four channels are taken without a copy, too
            color = colors(rng, size, channels, dtype)[..., :shown]
            depth, motion = geometry(rng, size)
            frame = RenderedFrame(color, depth, motion, view, 0.0)
            expected, infinite, clamped = twins.convert_color(color)
            *geometry_expected, counts = twins.convert_geometry(depth, motion)
            found = taken(stage, frame)
            assert found[0].tobytes() == expected.tobytes()
            for array, like in zip(found[1:], geometry_expected, strict=True):
                np.testing.assert_array_equal(array, like)
            bad = BadPixels(infinite, clamped, *counts)
            assert stage.take_bad_pixels() == bad == host_arrays(frame).bad


@pytest.mark.parametrize("dtype", [np.float64, ">f4", ">f2"])
def test_other_types_are_rounded_once(device, stage_of, dtype):
    size, rng = (61, 33), np.random.default_rng(3)
    depth, motion = geometry(rng, size)
    color = colors(rng, size, 3, dtype)
    halves = np.clip(rng.normal(0, 1e4, color.shape), -65000, 65000).astype(np.float16).astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        spacing = np.spacing(halves.astype(np.float16)).astype(np.float64)
    if np.dtype(dtype).itemsize > 4:  # a little beside the middle of two halves, which float32 does not tell from it
        color[::2] = (halves + spacing / 2 + np.copysign(1e-9, rng.normal(0, 1, color.shape)) * np.abs(spacing))[::2]
    frame = RenderedFrame(color, depth.astype(">f4"), motion.astype(np.float64), camera(*size), 0.0)
    found = taken(stage_of(size), frame)
    rgb = np.clip(np.nan_to_num(color, posinf=65504, neginf=-65504), -65504, 65504).astype(np.float16)
    assert found[0][..., :3].tobytes() == rgb.tobytes() and not found[0][..., 3].any()
    for array, like in zip(found[1:], twins.convert_geometry(depth, motion), strict=False):
        np.testing.assert_array_equal(array, like)


def test_layouts_that_must_be_copied(device, stage_of):
    """Reversed rows, columns of larger images, memory that is not aligned, frames that nobody may write."""
    size, rng = (31, 20), np.random.default_rng(5)
    stage, view = stage_of(size), camera(*size)
    color = colors(rng, (62, 20), 3, np.float32)[::-1, ::2]
    depth, motion = geometry(rng, size)
    unaligned = np.frombuffer(b"-" + depth.tobytes(), np.float32, offset=1).reshape(depth.shape)
    motion.flags.writeable = False
    found = taken(stage, RenderedFrame(color, unaligned, motion, view, 0.0))
    assert found[0].tobytes() == twins.convert_color(color)[0].tobytes()
    for array, like in zip(found[1:], twins.convert_geometry(depth, motion), strict=False):
        np.testing.assert_array_equal(array, like)


def test_reset_without_motion(device, stage_of):
    """Zeros take the place of what was there before."""
    size, rng = (31, 20), np.random.default_rng(6)
    stage, (depth, _) = stage_of(size), geometry(rng, size)
    color = colors(rng, size, 3, np.float32)
    *_, motion = taken(stage, RenderedFrame(color, depth, None, camera(*size), 0.0, reset=True))
    assert not motion.any() and stage.take_bad_pixels().motion == 0


def test_values_that_were_never_written_are_unknown(device):
    """The largest half float, or -1 in UV, in place of a motion vector is as NaN; depth beyond 1e37 is as sky, a
    denormal number as 0."""
    size, rng = (64, 48), np.random.default_rng(8)
    written = rng.random(size[::-1]) < 0.8
    made = {}
    for given in ("unknown", "never written"):
        pipeline = Pipeline(device, *size, Options(shading_correction=False))
        for k in range(2):
            color = np.random.default_rng(k).random((*size[::-1], 3), np.float32)
            motion = np.full((*size[::-1], 2), 1.5, np.float32)
            depth = np.linspace(2, 9, size[0] * size[1], dtype=np.float32).reshape(size[::-1])
            unknown = given == "unknown"
            motion[~written] = np.nan if unknown else (-size[0], -size[1]) if k else 65504
            depth[:4], depth[4:6] = (np.inf, 0) if unknown else (3e38, 1e-41)
            pipeline.submit(RenderedFrame(color, depth, motion, camera(*size), k / 30, reset=k == 0))
        made[given] = pipeline.extrapolate(camera(*size)).numpy("color")
        bad = pipeline.bad_pixels
        if not unknown:
            assert bad == BadPixels(depth=2 * 2 * size[0], far=2 * 4 * size[0], long=2 * np.count_nonzero(~written))
            assert "motion longer than the image's diagonal" in str(bad) and "1e37" in str(bad)
    np.testing.assert_array_equal(made["unknown"], made["never written"])


def stored(rng, size, type_name, *channels):
    """Values of a type, with those that mean something else."""
    dtype, shape = TYPES[type_name][0], (*size[::-1], *channels)
    if np.dtype(dtype).kind != "f":
        limits = np.iinfo(dtype)
        values, others = rng.integers(limits.min, limits.max, shape, dtype, endpoint=True), [0, limits.max]
    else:
        values, others = rng.uniform(-0.1, 1, shape), [0, 1, np.nan, np.inf, -np.inf, 1e30, 1e-41]
    with np.errstate(over="ignore"):
        return np.where(rng.random(shape) < 0.1, rng.choice(others, shape), values).astype(dtype)


DESCRIPTIONS = {
    "plain": FrameFormat(),
    "OpenXR": FrameFormat.openxr(
        nearZ=np.inf, farZ=0.3, motionVectorScale=(2, 3, 1, 0), motionVectorOffset=(-1, 0.1, 0, 0), motion_invalid=1.0,
        motion_jittered=True, geometry_size=(61, 33), color_size=(61, 33),
    ),
    "logarithmic": FrameFormat(depth="logarithmic", near_z=0.02, far_z=3000),
    "logarithmic of 1 + z, reversed": FrameFormat(depth="logarithmic", near_z=0, far_z=500, depth_range=(0.9, -0.1)),
    "movers only": FrameFormat(
        depth="device", near_z=0.1, far_z=50, motion_unit="uv", motion_y="up", motion_invalid=0.0,
        camera_motion="movers_only",
    ),
    "sRGB from below, distances": FrameFormat(
        rows="up", color_encoding="srgb", depth="distance", depth_scale=0.01, motion_unit="uv"
    ),
    "distances after a map": FrameFormat(depth="distance", near_z=1, far_z=900, depth_range=(1, 0), depth_scale=3),
    "excluded": FrameFormat(near_z=2, far_z=9, rows="up", motion_direction="from_previous", camera_motion="excluded"),
}  # fmt: skip


@pytest.mark.parametrize("described", DESCRIPTIONS)
def test_described_frames_equal_their_twin(device, stage_of, described):
    """All types, one after another in the same stage, in arrays and in buffers, with and without a frame before."""
    size, rng, format = (61, 33), np.random.default_rng(9), DESCRIPTIONS[described]
    stage, now, before = stage_of(size), camera(*size, (0.3, -0.1, 0.6), 0.1), camera(*size, (0, 0, 0), -0.05, 0.04)
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    previous = DeviceFrame.allocate(device, size, before, before, 0.0)
    types = zip(2 * COLOR_TYPES, 2 * (*DEPTH_TYPES, "float32"), (*MOTION_TYPES, None, *MOTION_TYPES[1:]), strict=False)
    for number, names in enumerate(types):
        types = dict(zip(("color", "depth", "motion"), names, strict=True))
        channels = {"color": 3 + number % 2, "motion": 2 + number % 3}
        color, depth = stored(rng, size, types["color"], channels["color"]), stored(rng, size, types["depth"])
        motion = types["motion"] and stored(rng, size, types["motion"], channels["motion"])
        given = conversion(format, size, types, channels, (0.2, -0.4), (-0.3, 0.1))
        taken = DeviceFrame.allocate(device, size, now, now, 0.1)
        last = previous if number % 3 else None
        step = Step(taken, last, [0.1, 0.0][: 1 + bool(last)], given=given)
        if number % 2 and channels["motion"] == 2:
            stage.take(of_arrays(color, depth, motion), taken, step=step)
        else:
            arrays = {"color": color, "depth": depth} | ({} if motion is None else {"motion": motion})
            buffers = {name: cl.Buffer(device.context, flags, hostbuf=array) for name, array in arrays.items()}
            stage.convert(buffers, taken, step)
        rgb, infinite, clamped = twins.convert_described_color(color, given)
        to_previous = reprojection(now, before) if last else None
        vectors = None if motion is None else motion[..., :2]
        inverse = reprojection(now, now)[4]
        z, moved, counts = twins.convert_described_geometry(depth, vectors, given, to_previous, source_inverse=inverse)
        found = [np.empty_like(array) for array in (rgb, z, moved)]
        for array, buffer in zip(found, taken.buffers, strict=True):
            cl.enqueue_copy(device.queue, array, buffer)
        assert found[0].tobytes() == rgb.tobytes(), names
        np.testing.assert_array_equal(found[1], z, err_msg=str(names))
        np.testing.assert_array_equal(found[2], moved, err_msg=str(names))
        assert stage.take_bad_pixels() == BadPixels(infinite, clamped, *counts), names


def of_regions(rng, size):
    """Color, depth and motion with edges: of each its own regions, noise within them, and numbers that are none."""
    x, y = np.meshgrid(*(np.arange(n) for n in size))
    region = ((x + y // 2) // 5 + y // 7) % 4
    color = np.array([0, 0.1, 0.8, 9])[region][..., None] * rng.uniform(0.8, 1.2, (*size[::-1], 3))
    depth = np.array([2.0, 2.01, 7, np.inf])[region] * rng.uniform(0.99, 1.01, size[::-1])
    motion = rng.normal(np.array([0, 3, 7, -2])[region][..., None], 1, (*size[::-1], 2))
    color[rng.random(size[::-1]) < 0.02], depth[rng.random(size[::-1]) < 0.02] = np.nan, 0
    motion[rng.random(size[::-1]) < 0.02] = np.nan
    return color.astype(np.float16), depth.astype(np.float32), motion.astype(np.float32)


@pytest.mark.parametrize(
    ("size", "geometry"),
    [((61, 33), (31, 17)), ((61, 33), (61, 11)), ((250, 7), (84, 6)), ((3, 2), (1, 1)), ((61, 33), (41, 22))],
    ids=str,
)
def test_smaller_geometry_equals_its_twin(device, stage_of, size, geometry):
    """Bit for bit, in arrays and in buffers; bad pixels are counted once, those of the frame before not at all."""
    rng, now, before = np.random.default_rng(5), camera(*size, (0.3, -0.1, 0.6), 0.1), camera(*size)
    stage, format = stage_of(size), FrameFormat(camera_motion="movers_only", motion_invalid=-3.0)
    color, (_, depth, motion) = of_regions(rng, size)[0], of_regions(rng, geometry)
    motion[::3, ::2] = -3
    types = {"color": "float16", "depth": "float32", "motion": "float32"}
    given = conversion(format, size, types, {"color": 3, "motion": 2}, (0.6, -0.9), (0.1, 0.0), geometry)
    previous, taken = (DeviceFrame.allocate(device, size, view, view, 0.0) for view in (before, now))
    rgb, *bad_colors = twins.convert_color(color)
    small = twins.convert_described_geometry(depth, motion, given, reprojection(now, before), size[::-1])
    expected = twins.spread_geometry(rgb, *small[:2], given)
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    for of_host in (True, False):
        step = Step(taken, previous, [0.1, 0.0], given=given)
        if of_host:
            whole = conversion(format, size, types, {"color": 3, "motion": 2})
            many = np.full(size[::-1], -1, np.float32), np.full((*size[::-1], 2), np.nan, np.float32)
            stage.take(of_arrays(color, *many), taken, step=Step(taken, None, [0.0], given=whole))
            assert stage.take_bad_pixels() == BadPixels(*bad_colors, many[0].size, many[0].size)
            stage.take(of_arrays(color, depth, motion), taken, step=step)
        else:
            arrays = {"color": color, "depth": depth, "motion": motion}
            buffers = {name: cl.Buffer(device.context, flags, hostbuf=array) for name, array in arrays.items()}
            stage.convert(buffers, taken, step)
        assert stage.take_bad_pixels() == BadPixels(*bad_colors, *small[2])
        for array, buffer in zip(expected, (taken.depth, taken.motion), strict=True):
            found = np.empty_like(array)
            cl.enqueue_copy(device.queue, found, buffer)
            np.testing.assert_array_equal(found, array)


@pytest.mark.parametrize("has_previous", [True, False])
@pytest.mark.parametrize(
    ("size", "geometry"), [((61, 33), (61, 33)), ((61, 33), (31, 17)), ((4, 3), (4, 3)), ((3, 2), (1, 1))], ids=str
)
def test_undone_dilation_equals_its_twin(device, stage_of, size, geometry, has_previous):
    """Bit for bit, also of geometry that is spread afterwards."""
    rng, now, before = np.random.default_rng(11), camera(*size, (0.3, -0.1, 0.6), 0.1), camera(*size)
    stage, format = stage_of(size), FrameFormat(motion_dilated=True)
    color, (_, depth, motion) = of_regions(rng, size)[0], of_regions(rng, geometry)
    depth[rng.random(depth.shape) < 0.02] = np.inf
    types = {"color": "float16", "depth": "float32", "motion": "float32"}
    given = conversion(format, size, types, {"color": 3, "motion": 2}, (0.6, -0.9), (0.1, 0.0), geometry)
    previous, taken = (DeviceFrame.allocate(device, size, view, view, 0.0) for view in (before, now))
    rgb, _, _ = twins.convert_color(color)
    to_previous = reprojection(now, before)
    z, moved, _ = twins.convert_described_geometry(depth, motion, given, to_previous, size[::-1])
    static = twins.motion_by_camera(z, given, to_previous)
    made = twins.undilated(moved, z, static if has_previous else None)
    expected = (z, made) if geometry == size else twins.spread_geometry(rgb, z, made, given)
    step = Step(taken, previous if has_previous else None, [0.1, 0.0][: 1 + has_previous], given=given)
    stage.take(of_arrays(color, depth, motion), taken, step=step, is_dilated=True)
    for array, buffer in zip(expected, (taken.depth, taken.motion), strict=True):
        found = np.empty_like(array)
        cl.enqueue_copy(device.queue, found, buffer)
        np.testing.assert_array_equal(found, array)


def test_undilated_vectors_are_the_surfaces_own():
    """A mover before a wall, both with edges and slopes: dilation spoils a rim of the wall, and shifts the vectors of
    slopes. Undone, all are exact but for one pixel at borders of slopes, and none without dilation changes by more."""
    y, x = np.mgrid[:40, :60].astype(np.float32)
    is_mover = np.hypot(x - 30, y - 20) < 9
    depth = np.where(is_mover, 3 + 0.02 * x, 9 + 0.03 * x)
    motion = np.stack([np.where(is_mover, 5 + 0.2 * x, 0.1 * x), 0 * x], -1)
    dilated = nearest_motion(motion, depth)
    found = twins.undilated(dilated, depth, motion)
    off, spoiled = np.abs(found - motion).max(-1), np.abs(dilated - motion).max(-1)
    assert (spoiled > 1).sum() > 50 and (spoiled > 0.05).mean() > 0.95
    assert (off > 0.21).sum() == 0 and (off > 0).mean() < 0.05


def test_kernel_and_description_number_alike():
    numbers = constants("upload.cl")
    assert [numbers[name.upper()] for name in TYPES] == [*range(1, len(TYPES) + 1)] and numbers["NO_BUFFER"] == 0
    assert [numbers[f"DEPTH_{name.upper()}"] for name in DEPTHS] == [*range(len(DEPTHS))]
    assert [numbers[f"CAMERA_{name.upper()}"] for name in CAMERA_MOTIONS] == [*range(len(CAMERA_MOTIONS))]


def test_arrays_may_be_changed_after_submit(device):
    """... and bad pixels of a frame are counted once, whenever somebody asks."""
    rng, size = np.random.default_rng(7), (64, 48)
    pipeline = Pipeline(device, *size, Options(shading_correction=False))
    color, depth, motion = colors(rng, size, 3, np.float32), *geometry(rng, size)
    expected = twins.convert_color(color)[0]
    total = host_arrays(frame := RenderedFrame(color, depth, motion, camera(*size), 0.0, reset=True)).bad
    pipeline.submit(frame)
    color[:], motion[:] = 1, 0
    assert pipeline.present().numpy("color").tobytes() == expected[..., :3].tobytes()
    assert pipeline.bad_pixels == pipeline.bad_pixels == total
    depth[:] = -1
    pipeline.submit(RenderedFrame(color, depth, motion, camera(*size), 0.1))
    assert pipeline.bad_pixels == total + BadPixels(depth=depth.size)
