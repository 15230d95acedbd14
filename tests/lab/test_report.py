"""Pictures for people: where captions and images stand on a contact sheet."""

import numpy as np

from gffe_cl.lab.report import contact_sheet


def test_captions_stand_above_their_images():
    red, green = (np.broadcast_to(np.float32(color), (30, 60, 3)) for color in ((1, 0, 0), (0, 1, 0)))
    groups = [("first", [("red", red), ("green", green), ("red again", red)]), ("second", [("green", green)])]
    sheet = np.asarray(contact_sheet(groups, columns=2, cell_width=120)).astype(int)
    reds, greens = ((sheet[..., k] > 250) & (sheet.sum(-1) < 260) for k in (0, 1))

    def boxes(mask, left):
        """(top, bottom) of the images in the column that begins at `left`."""
        rows = np.flatnonzero(np.diff(np.pad(mask[:, left + 60].astype(int), 1)))
        return list(zip(rows[::2], rows[1::2], strict=True))

    first, third = boxes(reds, 8)
    (second,) = boxes(greens, 8 + 128)
    (fourth,) = boxes(greens, 8)
    assert first == second and all(bottom - top == 60 for top, bottom in (first, third, fourth))
    paper = sheet[-1, -1]
    for top, bottom, left in ((*first, 8), (*second, 136), (*third, 8), (*fourth, 8)):
        caption = sheet[top - 28 : top, left : left + 120]
        assert (caption != paper).any(), "no caption above"
        below = sheet[bottom : bottom + 4, left : left + 120]
        assert (below == paper).all(), "text below"
    labels = [sheet[:28, :60], sheet[fourth[0] - 56 : fourth[0] - 28, :60]]
    assert all((label != paper).any() for label in labels)
