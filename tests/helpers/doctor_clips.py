"""Short sequences for tests of the doctor, exact in everything, and what it says of them."""

import json
from functools import cache

import numpy as np
from synthetic import Rect, Rects, camera

from gffe_cl.captures.doctor.hypotheses.transfer_function import srgb_to_linear
from gffe_cl.captures.sequence import SequenceWriter, named_channels
from gffe_cl.lab.fault_injection import Kept

W, H, COUNT = 120, 68, 9
NEAR_ENOUGH = 0.1  # pixels


def made_world():
    rects = [
        Rect((0, 0, 24), (40, 30), frequency=0.35),
        Rect((1.2, 0.3, 4), (0.7, 0.9), (1.5, 0, 0), 1.1, (0.7, 0.5, 0.2)),
    ]
    rng = np.random.default_rng(3)
    for k in range(7):
        place = (rng.uniform(-5, 5), rng.uniform(-2.5, 2.5), rng.uniform(5, 14))
        tint = tuple(rng.uniform(0.2, 0.8, 3))
        rects.append(Rect(place, tuple(rng.uniform(0.5, 1.8, 2)), frequency=0.4 + 0.1 * k, tint=tint))
    return Rects(rects)


@cache
def clip(moves=True, turns=True):
    """Return frames of rectangles, one of which moves; exact in everything."""
    world, frames, before = made_world(), [], None
    for k in range(COUNT):
        time = k / 30
        at = (0.09 * k + 0.01 * k * k, 0.03 * k, 0.06 * k) if moves else (0, 0, 0)
        angles = dict(yaw=0.012 * k + 0.002 * k * k, pitch=-0.008 * k, roll=0.006 * k) if turns else {}
        view = camera(W, H, at, **angles)
        frames.append(world.frame(view, time, W, H, before, reset=k == 0, samples=2))
        before = view, time
    return Kept(frames)


def names(diagnosis):
    return [f"{f.about}: {f.name}" for f in diagnosis.faults]


def motion_of(frames):
    return np.stack([frame.motion for frame in frames[1:]])


def reprojected(frames):
    """Return (frames, H, W, 2) pixels, by `Camera` alone: where static points were one frame before."""
    y, x = np.mgrid[:H, :W] + 0.5
    px = np.stack([x, y], -1)
    return np.stack([
        before.camera.project(here.camera.unproject(px, np.minimum(here.depth.astype(np.float64), 1e6)))[0]
        for before, here in zip(frames, frames[1:], strict=False)
    ])  # fmt: skip


def assert_restored(frames):
    good = clip().images
    assert all((made.color == true.color).all() for made, true in zip(frames, good, strict=True))
    for made, true in ((motion_of(frames), motion_of(good)), (reprojected(frames), reprojected(good))):
        assert (np.linalg.norm(made - true, axis=-1) < NEAR_ENOUGH).mean() > 0.95


class Tile(Rect):
    """Tiles of eight texels, whose channels end 0.3 texels from each other, as in photographs; texels are filtered as
    they are stored, in sRGB, and made linear after that."""

    def texture(self, uv):
        colors = np.random.default_rng(round(100 * self.frequency)).uniform(0.05, 0.95, (64, 64, 3))
        made = []
        for channel in range(3):
            at = 6 * uv[..., :2] + 1000 + 0.3 * channel
            low, share, mixed = np.floor(at).astype(int), at - np.floor(at), 0
            for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
                texel = colors[(low[..., 1] + dy) // 8 % 64, (low[..., 0] + dx) // 8 % 64, channel]
                mixed = mixed + np.where((dx, dy), share, 1 - share).prod(-1) * texel
            made.append(mixed)
        return srgb_to_linear(np.stack(made, -1))


@cache
def tiled(samples):
    """Return frames of tiles past which the camera moves; `samples` across a pixel: 1 is without antialiasing."""
    world, frames, before = Rects([Tile(r.center, r.half, frequency=r.frequency) for r in made_world().rects]), [], None
    for k in range(4):
        view = camera(2 * W, 2 * H, (0.09 * k, 0, 0))
        frames.append(world.frame(view, k / 30, 2 * W, 2 * H, before, reset=k == 0, samples=samples))
        before = view, k / 30
    return Kept(frames)


def written(folder, kept):
    with SequenceWriter(folder, W, H, 30.0) as writer:
        for entry in kept.rendered:
            frame = kept.read(entry)
            writer.add(entry, named_channels(frame.color, frame.depth, frame.motion))
    return folder


def as_folder(folder, kept, **parts):
    """Return a `gffe-folder` that says of `kept` that it is in our conventions, less what `parts` say."""
    folder.mkdir()
    for number, frame in enumerate(kept.images):
        for name in ("color", "depth", "motion"):
            np.save(folder / f"{name}_{number}.npy", getattr(frame, name).astype(np.float32))
    views = [{"view": f.camera.world_to_view.tolist(), "fx": f.camera.fx} for f in kept.images]
    document = {"format": "gffe-folder", "version": 1, "width": W, "height": H, "fps": 30}
    document |= {"frames": {"first": 0, "count": len(views)}, "camera": {"list": views}}
    document |= {name: {"file": f"{name}_%d.npy"} for name in ("color", "depth", "motion")}
    (folder / "sequence.json").write_text(json.dumps(document | parts))
    return folder


def follow_advice(folder, findings):
    """Change the keys of a `gffe-folder` as `findings` say."""
    document = json.loads((folder / "sequence.json").read_text())
    for finding in findings:
        part, _, keys = finding.change.partition(": ")
        document[part] |= json.loads("{" + keys + "}")
    (folder / "sequence.json").write_text(json.dumps(document))
