"""Why movers left a hole."""

from types import SimpleNamespace

from gffe_cl.engine.inspection.explain import refusals


def test_the_test_that_refused_a_mover_is_named(monkeypatch):
    depths = {(5, 10): 2.0, (16, 10): 2.05, (10, 5): 3.0, (10, 15): 2.0, (9, 10): 2.0}
    hidden = set(depths)
    monkeypatch.setattr(refusals, "_was_hidden", lambda p, s, block, x, y: ((x, y) in hidden, ""))
    block = SimpleNamespace(pixel=(10, 10), reach=9, at=lambda name, x, y: [depths[x, y]])

    def said(**found):
        ways = {"left": (-1, 0), "right": (1, 0), "up": (0, -1), "down": (0, 1)}
        by_way = {ways[name]: at for name, at in found.items()}
        return refusals._why_not_owned(None, None, block, by_way, next(iter(by_way)))

    far = "that mover is 5.0 px away, more than the 3.0 px within which one side is enough, and "
    assert said(left=(5, 10)) == f"{far}nothing moves on the other side within 9 px"
    assert said(left=(5, 10), right=(16, 10)).endswith("side, at (16, 10), is 11.0 px from it, more than 9 px")
    assert said(up=(10, 5), down=(10, 15)).endswith("(10, 15), is another one: its depth is 2, not 3")
    hidden.remove((10, 15))
    assert said(up=(10, 5), down=(10, 15)) == f"{far}the mover on the other side, at (10, 15), has no hidden part here"
    assert said(left=(9, 10)).endswith("1.0 px away, and up to 3.0 px one side is enough: nothing refuses it")
