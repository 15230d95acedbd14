"""How each layer is displayed: fitted to its picture at the first look, changed by the user, remembered."""

from __future__ import annotations

from dataclasses import replace

from gffe_cl.viewer.layers import Display, LayerSpec, default_display, fitted


class Looks:
    """Displays of a model's layers by name. A display is never changed in place."""

    def __init__(self, model):
        self._model = model
        self._displays: dict[str, Display] = {}

    def of(self, name: str) -> Display:
        """How the layer `name` is displayed now."""
        if name not in self._displays:
            saved = self._model.settings.displays.get(name)
            spec = self._model.spec_of(name)
            if saved is None:
                return Display() if spec is None else default_display(spec)
            self._displays[name] = Display.from_dict(saved)
        return self._displays[name]

    def meet(self, names) -> None:
        """Layers whose images are there: those that were never looked at get a range that fits."""
        for name in names:
            spec = self._model.spec_of(name)
            if name not in self._displays and name not in self._model.settings.displays and spec is not None:
                self._displays[name] = self._fitted(spec, default_display(spec))

    def forget(self) -> None:
        """Other pictures: what was fitted to the old ones does not hold for them."""
        self._displays.clear()

    def change(self, **values) -> None:
        """Display the shown layer with these `values` from now on."""
        self._keep(self._model.view.a, replace(self.of(self._model.view.a), **values))

    def expose(self, stops: float) -> None:
        self.change(exposure=self.of(self._model.view.a).exposure + stops)

    def fit(self) -> None:
        """Range from the picture."""
        spec = self._model.spec_of(self._model.view.a)
        if spec is not None:
            self._keep(spec.name, self._fitted(spec, self.of(spec.name)))

    def reset(self) -> None:
        spec = self._model.spec_of(self._model.view.a)
        if spec is not None:
            self._displays[spec.name] = self._fitted(spec, default_display(spec))
            self._model.settings.displays.pop(spec.name, None)

    def next_channel(self) -> None:
        spec = self._model.spec_of(self._model.view.a)
        if spec is not None:
            now = self.of(spec.name).channel
            index = spec.channels.index(now) if now in spec.channels else 0
            self.change(channel=spec.channels[(index + 1) % len(spec.channels)])

    def _keep(self, name: str, display: Display) -> None:
        self._displays[name] = display
        self._model.settings.displays[name] = display.to_dict()

    def _fitted(self, spec: LayerSpec, display: Display) -> Display:
        model = self._model
        image = model.image_of(spec.name)
        if image is None:
            return display
        return fitted(spec, image, display, model.frame_info(model.result), model.image_of("rendered.depth"))
