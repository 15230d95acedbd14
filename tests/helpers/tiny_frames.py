"""A few tiny frames, for tests that look at anything but pictures."""

from synthetic import Rect, Rects, camera

W, H = 24, 16


def frames(count=3, width=W, height=H):
    """Yield rendered frames of a mover before a wall."""
    scene, poses = Rects([Rect((0, 0, 5), (9, 9)), Rect((0, 0, 3), (0.5, 0.5), (3, 0, 0))]), []
    for k in range(count):
        poses.append((camera(width, height, (0.1 * k, 0, 0)), k / 30))
        yield scene.frame(*poses[-1], width, height, poses[k - 1] if k else None, reset=k == 0)
