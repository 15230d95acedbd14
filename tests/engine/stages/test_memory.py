"""Memory that stages lend each other: the order in which parts of buffers are released."""

from types import SimpleNamespace

from gffe_cl.engine.stages.buffers import Sizes
from gffe_cl.engine.stages.memory import LentMemory


class Whole:
    """Stands for a buffer; notes the parts that are released."""

    def __init__(self):
        self.released = []

    def get_sub_region(self, start, nbytes):
        return SimpleNamespace(release=lambda: self.released.append((start, nbytes)))


def test_parts_are_released_in_the_reverse_of_the_order_in_which_they_were_made():
    whole, memory = Whole(), LentMemory(Sizes((64, 48), (64, 48)), {})
    wanted = [(0, 100), (40, 50), (0, 20), (10, 200)]
    kept = [memory.part(whole, *place) for place in wanted]
    assert len(kept) == 4 and whole.released == []
    memory.let_go()
    assert whole.released == wanted[::-1]
