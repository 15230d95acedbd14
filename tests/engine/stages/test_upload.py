"""NumPy arrays on their way to the device: their bits, and the counts of bad pixels."""

import json
from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from recorded_bits import CONVERTING, DESCRIPTIONS, PATH, converted_digest, in_buffers, read_frame
from synthetic import camera

from gffe_cl import FrameFormat, Options, Pipeline, RenderedFrame
from gffe_cl.captures.sequence.encoding import nearest_motion
from gffe_cl.captures.sequence.engine_form import described_frame, undilated
from gffe_cl.engine.frame.frame_format import CAMERA_MOTIONS, DEPTHS, TYPES, jitter_in_color
from gffe_cl.engine.frame.rendered_frame import BadPixels, host_arrays
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.upload import Upload

RECORDED = json.loads(PATH.read_text())["converted"]
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


def convert_color(color):
    """Return (H, W, 4) float16 from (H, W, 3 or 4) half or float, with 0 in the fourth channel; how many pixels hold
    NaN or infinity; and how many were clamped."""
    rgb = color[..., :3].astype(np.float32)
    finite = np.isfinite(rgb)
    out = np.zeros((*color.shape[:2], 4), np.float16)
    out[..., :3] = np.clip(np.where(np.isnan(rgb), 0, rgb), -65504, 65504)
    return out, (~finite).any(-1).sum(), (finite & (np.abs(rgb) > 65504)).any(-1).sum()


def convert_geometry(depth, motion):
    """Return depth without denormal numbers and with sky beyond 1e37, motion without vectors as long as the diagonal,
    and how many depths are invalid, how many vectors not finite, how many depths too far, and how many vectors too
    long."""
    invalid, far = ~(depth >= np.finfo(np.float32).tiny), np.isfinite(depth) & (depth > 1e37)
    finite = np.isfinite(motion).all(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        long = finite & (np.square(motion).sum(-1) >= np.square(depth.shape).sum())
    converted = np.where(far, np.float32(np.inf), np.where(invalid & (depth >= 0), np.float32(0), depth))
    return (
        converted,
        np.where(long[..., None], np.float32(np.nan), motion),
        (
            invalid.sum(),
            (~finite).sum(),
            far.sum(),
            long.sum(),
        ),
    )


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
def test_arrays_are_converted(device, stage_of, size, dtype):
    """All forms of arrays that are taken as they are, one after another in the same stage."""
    stage, rng, view = stage_of(size), np.random.default_rng(size), camera(*size)
    for channels in (3, 4):
        for shown in (channels, 3):  # the first three of four channels are taken without a copy, too
            color = colors(rng, size, channels, dtype)[..., :shown]
            depth, motion = geometry(rng, size)
            frame = RenderedFrame(color, depth, motion, view, 0.0)
            expected, infinite, clamped = convert_color(color)
            *geometry_expected, counts = convert_geometry(depth, motion)
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
    for array, like in zip(found[1:], convert_geometry(depth, motion), strict=False):
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
    assert found[0].tobytes() == convert_color(color)[0].tobytes()
    for array, like in zip(found[1:], convert_geometry(depth, motion), strict=False):
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


@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_described_frames_leave_the_recorded_bits(device, lanes, name):
    """All types of values, in arrays and in buffers, with and without a frame before, and the counts of bad pixels."""
    assert converted_digest(device, DESCRIPTIONS[name]) == RECORDED[name]


def of_regions(rng, size, format):
    """Depth and motion as an engine stores them: of each its own regions, and noise within them."""
    x, y = np.meshgrid(*(np.arange(n) for n in size))
    region, (low, high) = ((x + y // 2) // 5 + y // 7) % 4, format.depth_range
    shares = np.array([0.2, 0.201, 0.5, 0.8])[region] * rng.uniform(0.99, 1.01, size[::-1])
    motion = rng.normal(np.array([0, 0.06, 0.14, -0.04])[region][..., None], 0.02, (*size[::-1], 2))
    if format.motion_invalid is not None:
        motion[::3, ::2] = format.motion_invalid
    return (low + shares * (high - low)).astype(np.float32), motion.astype(np.float32)


SMALLER = FrameFormat(motion_unit="color_pixels")
DILATED = replace(SMALLER, motion_dilated=True)
FORMS = {
    **{f"{name}, {size}": (format, size, size) for name, format in DESCRIPTIONS.items() for size in [(61, 33)]},
    **{
        f"{'dilated' if format is DILATED else 'smaller'}, {geometry}": (format, size, geometry)
        for format in (SMALLER, DILATED)
        for size, geometry in (
            ((61, 33), (31, 17)),
            ((61, 33), (61, 11)),
            ((250, 7), (84, 6)),
            ((3, 2), (1, 1)),
            ((61, 33), (41, 22)),
        )
    },
    "dilated": (DILATED, (61, 33), (61, 33)),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("has_previous", [True, False])
def test_device_and_host_convert_alike(device, lanes, form, has_previous):
    """Within rounding, and to the bit where geometry is smaller and dilation is undone, but for what the camera adds;
    in arrays and in buffers."""
    (format, size, geometry), rng = FORMS[form], np.random.default_rng(5)
    to_the_bit = format in (SMALLER, DILATED)
    format = replace(format, geometry_size=geometry, color_size=size, motion_type="float32", motion_channels=2)
    views = camera(*size), camera(*size, (0.3, -0.1, 0.6), 0.1)
    color = rng.choice([0, 0.1, 0.8, 1], (*size[::-1], 4)) * rng.uniform(0.8, 1, (*size[::-1], 4))
    made = []
    for k, view in enumerate(views):
        jitter = (0.2 + 0.3 * k, -0.4)
        arrays = color.astype(np.float16), *of_regions(rng, geometry, format)
        made.append(RenderedFrame(*arrays, view, k / 30, reset=not k or not has_previous, geometry_jitter=jitter))
    expected = described_frame(
        made[1], format, views[0] if has_previous else None, jitter_in_color(made[0].geometry_jitter, size, geometry)
    )
    for frames in (made, [in_buffers(device, frame) for frame in made]):
        pipeline = Pipeline(device, *size, CONVERTING, format=format)
        for frame in frames:
            pipeline.submit(frame)
        rgb, depth, motion = read_frame(device, pipeline.frames.current, size)
        np.testing.assert_allclose(rgb[..., :3], expected.color[..., :3], rtol=2e-3, atol=1e-6)
        np.testing.assert_allclose(depth, expected.depth, rtol=2e-5)
        np.testing.assert_allclose(motion, expected.motion, rtol=2e-5, atol=2e-3)
        if to_the_bit:
            same = (motion == expected.motion).all(-1)
            assert np.array_equal(depth, expected.depth) and (same.all() or (format.motion_dilated and same.any()))


def test_undilated_vectors_are_the_surfaces_own():
    """A mover before a wall, both with edges and slopes: dilation spoils a rim of the wall, and shifts the vectors of
    slopes. Undone, all are exact but for one pixel at borders of slopes, and none without dilation changes by more."""
    y, x = np.mgrid[:40, :60].astype(np.float32)
    is_mover = np.hypot(x - 30, y - 20) < 9
    depth = np.where(is_mover, 3 + 0.02 * x, 9 + 0.03 * x)
    motion = np.stack([np.where(is_mover, 5 + 0.2 * x, 0.1 * x), 0 * x], -1)
    dilated = nearest_motion(motion, depth)
    found = undilated(dilated, depth, motion)
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
    expected = convert_color(color)[0]
    total = host_arrays(frame := RenderedFrame(color, depth, motion, camera(*size), 0.0, reset=True)).bad
    pipeline.submit(frame)
    color[:], motion[:] = 1, 0
    assert pipeline.present().numpy("color").tobytes() == expected[..., :3].tobytes()
    assert pipeline.bad_pixels == pipeline.bad_pixels == total
    depth[:] = -1
    pipeline.submit(RenderedFrame(color, depth, motion, camera(*size), 0.1))
    assert pipeline.bad_pixels == total + BadPixels(depth=depth.size)
