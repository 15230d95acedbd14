"""Memory that stages lend each other: buffers that share one place, and the order in which parts go."""

import weakref

from gffe_cl.engine.stages.buffers import Sizes
from gffe_cl.engine.stages.memory import LentMemory


class Whole:
    """Stands for a buffer; notes the parts that are gone."""

    def __init__(self):
        self.gone = []

    def get_sub_region(self, start, nbytes):
        part = type("Part", (), {})()
        weakref.finalize(part, self.gone.append, (start, nbytes))
        return part


def test_parts_go_in_the_reverse_of_the_order_in_which_they_were_made():
    whole, memory = Whole(), LentMemory(Sizes((64, 48), (64, 48)), {})
    wanted = [(0, 100), (40, 50), (0, 20), (10, 200)]
    parts = [memory.part(whole, *place) for place in wanted]
    del parts[1], parts
    assert whole.gone == []
    memory.let_go()
    assert whole.gone == wanted[::-1]
