"""Sessions of a network on a provider with its own memory, with transfers in both directions and their times."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gffe_cl.engine.inference.providers import Provider, load_onnxruntime, open_session


def free_dimensions(session, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, int]:
    """Return the sizes of the free dimensions of a session's inputs by their names, where the inputs have `shapes`."""
    return {
        name: size
        for value in session.get_inputs()
        for name, size in zip(value.shape, shapes[value.name], strict=True)
        if isinstance(name, str)
    }


class FixedSession:
    """A session for inputs of one size.

    `copying`: milliseconds of the last run that went into copies between host and plug-in; 0 for providers that are
    built into onnxruntime, which work in the host's memory or copy as a part of the run.
    """

    def __init__(self, path: Path, provider: Provider, shapes: Mapping[str, tuple[int, ...]], free):
        """Open the session. `shapes`: of all inputs and of the output by name; `free`: any session of the model. Raises
        NetworkError."""
        self._runtime = load_onnxruntime()
        self.session = open_session(path, provider, free_dimensions(free, shapes))
        self.copying = 0.0
        self._binding = self.session.io_binding()
        self._inputs, self._outputs = {}, {}  # values in the provider's memory, by name
        if not provider.built_in:
            self._place(shapes)

    def run(self, inputs: Mapping[str, np.ndarray], name: str, output: np.ndarray) -> None:
        """Read `inputs`, write the model's output `name`: C-contiguous float32 of the declared shapes."""
        start = time.perf_counter()
        for key, array in inputs.items():
            if key in self._inputs:
                self._inputs[key].update_inplace(array)
            else:
                self._binding.bind_input(key, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        if not self._outputs:
            self._binding.bind_output(name, "cpu", 0, np.float32, output.shape, output.ctypes.data)
        sent = time.perf_counter()
        self.session.run_with_iobinding(self._binding)
        self._binding.synchronize_outputs()
        self._wait(inputs)
        done = time.perf_counter()
        if self._outputs:
            self._fetch(self._outputs[name], output)
        self.copying = (time.perf_counter() - done + (sent - start if self._inputs else 0.0)) * 1e3

    def _place(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        """Allocate values in the plug-in's memory for inputs and outputs that it cannot access on the host."""
        places = zip(self.session.get_inputs(), self.session.get_input_memory_infos(), strict=True)
        for value, place in places:
            if place.name != "Cpu":
                self._inputs[value.name] = self._value(shapes[value.name], place)
                self._binding.bind_ortvalue_input(value.name, self._inputs[value.name])
        (value,), (place,) = self.session.get_outputs(), self.session.get_output_memory_infos()
        if place.name != "Cpu":
            self._outputs[value.name] = self._value(shapes[value.name], place)
            self._binding.bind_ortvalue_output(value.name, self._outputs[value.name])

    def _value(self, shape, place):
        return self._runtime.OrtValue.ortvalue_from_shape_and_type(list(shape), np.float32, memory_info=place)

    def _wait(self, inputs: Mapping[str, np.ndarray]) -> None:
        """Wait until the provider has finished. WebGPU's runs return early, but a copy from its queue waits. The
        smallest input is copied, so that the time of the result's copy is known separately."""
        if self._inputs:
            name = min(self._inputs, key=lambda key: inputs[key].size)
            self._fetch(self._inputs[name], np.empty_like(inputs[name]))

    def _fetch(self, value, into: np.ndarray) -> None:
        self._runtime.copy_tensors([value], [self._runtime.OrtValue.ortvalue_from_numpy(into)])
