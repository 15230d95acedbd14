"""Which layers have to be read back for what is looked at."""

from __future__ import annotations

from gffe_cl.viewer.engine import names
from gffe_cl.viewer.picture.view import View
from gffe_cl.viewer.state.contents import Contents
from gffe_cl.viewer.state.disocclusions import Disocclusions
from gffe_cl.viewer.state.regions import Regions
from gffe_cl.viewer.state.selecting import Selection


class Needed:
    """Names of layers of A and of B."""

    def __init__(
        self, view: View, contents: Contents, regions: Regions, disocclusions: Disocclusions, selection: Selection
    ):
        self._view, self._contents = view, contents
        self._regions, self._disocclusions, self._selection = regions, disocclusions, selection

    def all(self) -> frozenset[str]:
        """Whatever there is."""
        return frozenset(spec.name for spec in self._contents.layers) or frozenset({names.FINAL})

    def of_first(self) -> frozenset[str]:
        view, wanted = self._view, {self._view.a}
        if view.compare != "off" and view.b and not names.is_second(view.b):
            wanted.add(view.b)
        wanted |= self._regions.needed | self._disocclusions.needed | self._selection.needed
        if view.overlay in ("edges", "residual motion"):
            wanted |= {names.RENDERED_COLOR, names.RENDERED_DEPTH, names.RENDERED_MOTION}
        specs = [self._contents.spec(name) for name in wanted]
        if any(spec is not None and spec.view == "world" for spec in specs):
            wanted.add(names.RENDERED_DEPTH)
        return frozenset(wanted)

    def of_second(self) -> frozenset[str]:
        return frozenset({self._view.a} | ({names.FINAL} & self._regions.needed))
