"""Choices of the user: what is looked at, with which options, and when; remembered from one start to the next."""

from __future__ import annotations

from gffe_cl.engine.inspection import names
from gffe_cl.engine.options import Options
from ..engine.jobs import Jobs
from ..engine.messages import Setup
from ..picture.current_frame import VECTORS, Contents
from ..picture.displays import Display
from ..picture.looks import Looks
from ..picture.view import View
from .comparing import Comparison
from .navigation import Framing
from .parameters import Parameters
from .playback import Playback
from .presets import KeptSettings
from .settings import Settings

_MEASURED = frozenset({names.FINAL, names.TRUTH})


class Choices:
    """Choices of the user.

    Attributes
    ----------
    settings : Settings
    view, framing, looks : View, Framing, Looks
        Layers, the part of them that is seen, and how each is displayed.
    parameters, kept, comparison : Parameters, KeptSettings, Comparison
        A's settings, those that are kept, and how A and B are compared.
    playback : Playback
    overview, measuring : bool
        All layers are shown; every shown frame is measured.
    """

    def __init__(
        self,
        settings: Settings,
        options: Options,
        playback: Playback,
        window: str | None,
        contents: Contents,
        background: Jobs,
    ):
        self.settings, self.playback, self._contents = settings, playback, contents
        self.parameters = Parameters(options, playback, window)
        self.view = View(names.FINAL, Display())
        self.framing, self.looks = Framing(self.view), Looks(contents, settings.displays)
        self.kept = KeptSettings()
        self.comparison = Comparison(self.view, contents, self.looks, self.kept, background)
        self.overview = self.measuring = False
        playback.restore(settings.playback)
        self.parameters.restore(settings.options)
        self.comparison.restore(settings.compare)
        self.kept.restore(settings.kept)

    def remember(self, window_size: tuple[int, int]) -> str | None:
        """Write the settings. Returns a warning if that is not possible, else None."""
        self.settings.window_size = window_size
        self.settings.playback = self.playback.preferences()
        self.settings.options = self.parameters.preferences()
        self.settings.compare = self.comparison.preferences()
        self.settings.kept = self.kept.preferences()
        return self.settings.save()

    @property
    def setup(self) -> Setup:
        return self.parameters.setup

    @property
    def second(self) -> Setup | None:
        """B's setup while anything of it is shown: that of A for a neighbor."""
        if self.overview or (self.comparison.neighbor and not self.comparison.is_shown):
            return None
        kept = self.comparison.second
        return self.setup if self.comparison.neighbor else None if kept is None else kept.setup(self.playback.n)

    @property
    def follows(self) -> bool:
        """Whether B is a neighbor that is shown where motion vectors lead."""
        return bool(self.comparison.neighbor) and self.comparison.follows and self.second is not None

    def layers(self) -> frozenset[str]:
        """Return the names of the layers that are read back of A; of the displayed image alone while they are not
        known."""
        if self.overview:
            return frozenset(spec.name for spec in self._contents.layers) or frozenset({names.FINAL})
        view, wanted = self.view, {self.view.a} | (_MEASURED if self.measuring else frozenset())
        if view.compare != "off" and view.b and not names.is_second(view.b):
            wanted.add(view.b)
        wanted |= VECTORS if self.follows else frozenset()
        specs = [self._contents.spec(name) for name in wanted]
        if any(spec is not None and spec.view == "world" for spec in specs):
            wanted.add(names.RENDERED_DEPTH)
        return frozenset(wanted)

    def layers_of_second(self) -> frozenset[str]:
        """Return the names of the layers that are read back of B."""
        if self.comparison.neighbor:
            return frozenset({self.view.a}) | (VECTORS if self.follows else frozenset())
        return frozenset({self.view.a}) | (_MEASURED if self.measuring else frozenset())
