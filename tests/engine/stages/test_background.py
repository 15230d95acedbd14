"""What the background promises, where the exact answer is known."""

from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from synthetic import Rect, Rects, camera

from gffe_cl import Options, Pipeline
from gffe_cl.captures.scenes import load_scene
from gffe_cl.captures.scenes.renderer import SceneFrames, SceneRenderer
from gffe_cl.engine.frame.window import Jitter, WindowChooser
from gffe_cl.engine.stages.background import REMEMBERED
from gffe_cl.engine.stages.buffers import BY_HIDDEN_PART, BY_REAPPEARING, OFFSET, RGB9E5

W, H = 128, 80
WALL = Rect((0, 0, 10), frequency=0.25)


def play(pipeline, scene, cameras, each=None, noise=0.0):
    """Submit a frame per camera, 1/30 s apart; calls each(k) after it."""
    rng = np.random.default_rng(2)
    previous = None
    for k, cam in enumerate(cameras):
        frame = (scene(k) if callable(scene) else scene).frame(cam, k / 30, W, H, previous, reset=k == 0)
        frame.depth *= 1 + noise * rng.standard_normal(frame.depth.shape).astype(np.float32)
        pipeline.submit(frame)
        previous = (cam, k / 30)
        if each:
            each(k)


@pytest.mark.parametrize("levels", [1, 2])
def test_square_crossing_a_wall_leaves_no_wrong_pixel(device, levels):
    """Every pixel that shows the wall at t + ½ has the wall's color: no ghost, hole or rim of the square (whose own
    outline may be off by the pixel that a splat rounds to)."""
    scene = Rects([WALL, Rect((-2.2, 0, 6), (0.7, 0.7), velocity=(12, 0, 0), tint=(5, 0.1, 0.1))])
    still = camera(W, H)
    pipeline = Pipeline(device, W, H, Options(levels=levels, hole_filling="downsample"))  # nothing is mixed in
    play(pipeline, scene, [still] * 12)
    out = pipeline.extrapolate(still, 11.5 / 30)
    truth = scene.frame(still, 11.5 / 30, W, H)
    square = truth.depth < 9
    wall = ~(square | np.roll(square, 1, 1) | np.roll(square, -1, 1))
    holes = out.numpy("disoccluded") == 1
    assert (holes & wall).sum() > 30 and (out.numpy("filled_by")[holes & wall] == 1).all()
    error = np.abs(out.numpy("color").astype(np.float32) - truth.color.astype(np.float32)).max(-1)
    assert (error[wall & holes] < 0.01).all(), error[wall & holes].max()
    assert (error[wall] < 0.05).all(), error[wall].max()  # beside the square colors are a pixel off


@pytest.mark.parametrize(("levels", "speed"), [(1, 0.0), (1, -1.5), (2, 0.0), (2, -1.5)])
def test_wall_behind_a_fence(device, levels, speed):
    """A strafing camera, bars before a finely patterned wall: what they hid and uncover again is remembered behind
    moving bars at full resolution, behind static ones at half of it, one level down, if there is one."""
    wall, xs = Rect((0, 0, 10), frequency=1.0), np.arange(-6, 12, 0.8)
    bars = [Rect((x, 0, 4), (0.12, 9), velocity=(speed, 0, 0), tint=(0.05, 0.3, 0.1)) for x in xs]
    step = 0.09 if speed else 0.18  # static bars hide again what is an EDGE now, unless that passes by 2 px a frame
    scene, target = Rects([wall, *bars]), camera(W, H, (step * 24, 0, 0))
    pipeline = Pipeline(device, W, H, Options(levels=levels))
    play(pipeline, scene, [camera(W, H, (step * k, 0, 0)) for k in range(24)])
    out, truth = pipeline.extrapolate(target, 24 / 30), scene.frame(target, 24 / 30, W, H)
    holes = (out.numpy("disoccluded") == 1) & (truth.depth > 9)
    holes[:, -8:] = False  # out of screen
    assert holes.sum() > 200
    error = np.abs(out.numpy("color").astype(np.float32) - truth.color.astype(np.float32))[holes].mean()
    filled_by = out.numpy("filled_by")[holes]
    if speed:
        assert error < 0.05 and (filled_by == 1).mean() > 0.9, (error, (filled_by == 1).mean())
    else:
        assert (filled_by == 2).mean() > 0.9 if levels > 1 else not np.isin(filled_by, (1, 2)).any()


def test_hidden_wall_does_not_creep(device):
    """A wall hidden for 60 frames of a 0.4 px/frame pan reappears within half a pixel of where it belongs, as far as
    remembered colors tell, whose rounding is worth 0.2 px here."""
    wall = Rect((0, 0, 10), ramp=True)
    still = camera(W, H)
    step = 0.4 * 10 / still.fx  # world units per frame that shift the wall by 0.4 px

    def scene(k):  # from frame 3 on a panel moves along with the camera, but for a slow drift that keeps it dynamic
        x = 60.0 if k < 3 else step * k
        return Rects([wall, Rect((x, 0.004 * k, 5), (0.9, 0.9), tint=(0, 0, 2))])

    previous = None
    pipeline = Pipeline(device, W, H, Options(levels=1, static_threshold=0.1, hole_filling="downsample"))
    for k in range(64):
        cam = camera(W, H, (step * k, 0, 0))
        frame = scene(k).frame(cam, k / 30, W, H, previous, reset=k == 0)
        panel = frame.depth < 6
        # The last frame's motion lets the panel leave: 12 px down within the interval.
        frame.motion[panel] = (0.0, -0.004 * still.fy / 5 if k < 63 else -12.0)
        pipeline.submit(frame)
        previous = (cam, k / 30)
    assert pipeline.stages["history"].read("dynamic_mask")[panel].mean() > 0.95
    out = pipeline.extrapolate(cam, (63 + 1.5) / 30)
    revealed = panel & (out.numpy("disoccluded") == 1)
    assert revealed.sum() > 200 and (out.numpy("filled_by")[revealed] == 1).mean() > 0.95
    y, x = np.nonzero(revealed)
    world = cam.unproject(np.stack([x + 0.5, y + 0.5], -1), np.full(len(x), 10.0))
    where = (out.numpy("color")[revealed][:, :2].astype(np.float64) - 0.5) / 0.05  # the ramp tells the place
    error_px = np.abs(world[:, :2] - where) * still.fx / 10
    rounding_px = 2.0**-10 / 0.05 * still.fx / 10  # of colors from 0.5 to 1
    assert np.quantile(error_px, 0.95) < 0.5 + rounding_px, np.quantile(error_px, (0.5, 0.95, 1))


@pytest.mark.parametrize("levels", [1, 2])
def test_depth_noise_does_not_push_the_surface_down(device, levels):
    """200 frames of a wall and a slanting floor under 0.5% depth noise and a slow camera: nothing is remembered behind
    what is shown, nor in level 1."""
    rng = np.random.default_rng(4)
    pipeline = Pipeline(device, W, H, Options(levels=levels))
    y, _ = np.mgrid[:H, :W] + 0.5
    still = camera(W, H)
    with np.errstate(divide="ignore"):
        floor = np.where(y > H / 2, 1.5 * still.fy / np.maximum(y - H / 2, 1e-6), np.inf)
    depth = np.minimum(floor, 12.0)
    color = np.full((H, W, 3), 0.4, np.float16)
    previous = None
    from gffe_cl import RenderedFrame

    for k in range(200):
        cam = camera(W, H, (0.004 * np.sin(k / 9), 0, 0), yaw=0.002 * np.sin(k / 7))
        noisy = (depth * (1 + 0.005 * rng.standard_normal(depth.shape))).astype(np.float32)
        px = np.stack([_, y], -1)
        motion = np.zeros((H, W, 2), np.float32)
        if previous is not None:
            motion = (previous.project(cam.unproject(px, noisy))[0] - px).astype(np.float32)
        pipeline.submit(RenderedFrame(color, noisy, motion, cam, k / 30, reset=k == 0))
        previous = cam
    state = pipeline.stages["background"].read(f"state_{levels - 1}")
    fill = (state == REMEMBERED).mean()
    assert fill < 0.01, fill


def test_object_that_stood_still_leaves_no_ghost(device):
    """Once it walks, no pixel that shows the wall has the object's color, from its third moving frame on."""
    still = camera(W, H)

    def scene(k):
        x = 0.25 * max(k - 10, 0)
        return Rects([WALL, Rect((x - 1, 0, 6), (0.7, 0.7), tint=(5, 0.1, 0.1))])

    pipeline = Pipeline(device, W, H, Options(levels=2))
    ghosts = []
    for k in range(18):
        frame = scene(k).frame(still, k / 30, W, H, None, reset=k == 0)
        moved = 0.25 if k > 10 else 0.0
        frame.motion[frame.depth < 7] = (-moved * still.fx / 6, 0)
        pipeline.submit(frame)
        if k > 10:
            out = pipeline.extrapolate(still, (k + 0.5) / 30)
            truth = scene(k + 0.5).frame(still, k / 30, W, H)
            red = out.numpy("color")[..., 0] > 2
            ghosts.append(int((red & (truth.depth > 9)).sum()))
    assert max(ghosts[2:]) == 0, ghosts


def test_hole_inside_a_moving_object_is_not_the_backgrounds(device):
    """Fragments of a mover that are missing (bad depth) are filled with the mover, though the wall behind is known."""
    scene = Rects([WALL, Rect((-1.5, 0, 6), (0.9, 0.9), velocity=(6, 0, 0), frequency=0.1, tint=(5, 0.1, 0.1))])
    still = camera(W, H)
    pipeline = Pipeline(device, W, H, Options(levels=1))
    previous = None
    for k in range(8):
        frame = scene.frame(still, k / 30, W, H, previous, reset=k == 0)
        if k == 7:
            y, x = (int(v.mean()) for v in np.nonzero(frame.depth < 7))
            frame.depth[y - 2 : y + 2, x - 2 : x + 2] = np.nan
        pipeline.submit(frame)
        previous = (still, k / 30)
    out = pipeline.extrapolate(still, 7.5 / 30)
    truth = scene.frame(still, 7.5 / 30, W, H)
    inside = (out.numpy("disoccluded") == 1) & (truth.depth < 7)
    inside[:, : int(np.nonzero(truth.depth < 7)[1].min()) + 3] = False  # the trailing edge is no hole inside
    assert 9 <= inside.sum() <= 30 and (out.numpy("filled_by")[inside] == BY_HIDDEN_PART).all()
    assert (out.numpy("color")[inside, 0] > 2).all()


def test_memory_stays_constant(device):
    scene = Rects([WALL, Rect((-1.5, 0, 6), (0.7, 0.7), velocity=(3, 0, 0))])
    pipeline = Pipeline(device, W, H, Options(levels=3))
    sizes = []
    play(pipeline, scene, [camera(W, H, (0.05 * k, 0, 0)) for k in range(8)], lambda k: sizes.append(device.allocated))
    assert len(set(sizes[2:])) == 1


def test_nothing_is_collected_after_a_reset(device):
    scene = Rects([WALL, Rect((-1.5, 0, 6), (0.7, 0.7), velocity=(7, 0, 0), tint=(5, 0.1, 0.1))])
    pipeline = Pipeline(device, W, H, Options(levels=2))
    play(pipeline, scene, [camera(W, H)])
    for level in range(2):
        assert not pipeline.stages["background"].read(f"state_{level}").any()


@pytest.mark.parametrize("levels", range(5))
def test_any_number_of_levels(device, levels):
    scene = Rects([WALL, Rect((-1.5, 0, 6), (0.7, 0.7), velocity=(7, 0, 0))])
    pipeline = Pipeline(device, W - 1, H - 3, Options(levels=levels), render_size=(W, H))
    play(pipeline, scene, [camera(W, H, (0.05 * k, 0, 0)) for k in range(6)])
    out = pipeline.extrapolate(camera(W - 1, H - 3, (0.3, 0, 0)), 5.5 / 30)
    assert set(np.unique(out.numpy("filled_by"))) <= {0, 254, 255, *range(1, levels + 1)}
    assert np.isfinite(out.numpy("color")).all()


@pytest.mark.parametrize(("levels", "lanes"), [(0, 8), (1, 8), (2, 1), (4, 8)], indirect=["lanes"])
def test_lent_memory_holds_nothing_that_is_needed(device, levels, lanes):
    """Whatever lies in transient buffers after `submit`, also after a reset: two frames made from each are the same,
    and so is what the background remembers."""
    bars = [Rect((x, 0, 4), (0.12, 9), frequency=0.2, velocity=(3 * (x > 2), 0, 0)) for x in np.arange(-4, 8, 0.8)]
    scene, cams = Rects([WALL, *bars]), [camera(W, H, (0.09 * k, 0, 0)) for k in range(8)]

    def made(filler):
        pipeline, seen = Pipeline(device, W, H, Options(levels=levels)), []
        for k, cam in enumerate(cams):
            previous = (cams[k - 1], (k - 1) / 30) if k % 5 else None
            pipeline.submit(scene.frame(cam, k / 30, W, H, previous, reset=previous is None))
            for stage, spec in pipeline.board.memory.borrowing:
                buffer = stage.buffer[spec.name]
                cl.enqueue_fill_buffer(device.queue, buffer, np.uint8(filler), 0, buffer.size)
            for part in (0.3, 0.6):
                new = pipeline.extrapolate(cam, (k + part) / 30)
                seen += [new.numpy(name).tobytes() for name in ("color", "depth", "motion", "filled_by")]
            if levels:
                background = pipeline.stages["background"]
                seen += [background.read(f"{name}_0").tobytes() for name in ("color", "depth", "px", "state")]
        assert (new.numpy("disoccluded") == 1).any()
        return seen

    expected = made(0)
    assert all(made(filler) == expected for filler in (0xA5, 0xFF))


def test_parts_that_reappear_are_not_mixed_with_the_background(device):
    """Also at edges, where the background shows through other pixels of movers: whatever lies in lent memory."""
    size, render_size = (83, 61), (47, 33)
    renderer = SceneRenderer(device, load_scene("plaza", 1), *render_size)
    frames = list(SceneFrames(renderer, WindowChooser("off", size, [0.5]), size).sequence(3, 15.0))
    frames = [replace(frame, camera=Jitter(8).camera(frame.camera, k)) for k, frame in enumerate(frames)]

    def made(depth):
        pipeline, seen = (
            Pipeline(device, *size, Options(upscale=2.0, shading_correction=False), render_size=render_size),
            [],
        )
        for frame in frames:
            pipeline.submit(frame)
            new = pipeline.extrapolate(None, frame.time + 0.75 * pipeline.interval)
            seen.append(new.numpy("filled_by"))
            memory = pipeline.stages["background"].own("memory'")
            cl.enqueue_fill_buffer(device.queue, memory, np.float32(depth), 0, memory.size // 4 * 4)
        return np.array(seen)

    expected = made(np.nan)
    assert (expected == BY_REAPPEARING).any()
    for depth in (1.0, 5.0, 20.0):
        assert np.array_equal(made(depth), expected)


@pytest.mark.parametrize("int64", [None, False])
def test_silhouettes_borrow_most_of_their_memory(device, int64):
    """What is used at one time lies apart, what is not may lie in one place; where the background lends enough, all but
    marks of blocks, colors behind, which live from the warp on, and the list of soft pixels is lent."""
    pipeline = Pipeline(device, 640, 360, Options(levels=2), int64_atomics=int64)
    board = pipeline.board
    lent = [(board.stages[stage].spec(name), *where) for (stage, name), where in board.memory.places.items() if where]
    used = {spec.name: board.memory.use(stage, spec) for stage, spec in board.memory.borrowing}
    overlaps = set()
    for a, memory, start in lent:
        for b, other, begin in lent:
            if (
                memory == other
                and a is not b
                and start < begin + b.nbytes(board.sizes)
                and begin < start + a.nbytes(board.sizes)
            ):
                assert not used[a.name] & used[b.name], (a.name, b.name)
                overlaps.add((a.name, b.name))
    assert ("softened", "keys") in overlaps
    silhouettes = board.stages["silhouettes"]
    assert silhouettes.nbytes == sum(silhouettes.buffer[name].size for name in ("marked", "behind", "soft"))
    assert used["target_position"] > used["keys"]


def test_packed_texels_read_as_what_they_mean():
    """A color of three mantissas times 2^(exponent − 24), and a place from the texel's center, in a block's corner."""
    bits = np.array([[[256 | 128 << 9 | 1 << 18 | 16 << 27], [511 | 31 << 27]]], np.uint32)
    assert RGB9E5.unpack(bits, 0, 0, 1).tolist() == [[[1, 0.5, 2**-8, 0], [65408, 0, 0, 0]]]
    stored = np.array([[[16384, -32768]]], np.int16)
    assert OFFSET.unpack(stored, 3, 2, 2).tolist() == [[[8, 3]]]
