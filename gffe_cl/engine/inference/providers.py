"""Execution providers of onnxruntime: those that exist, and sessions on them."""

from __future__ import annotations

import ctypes
import importlib
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakSet

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import model_source


class NetworkError(GffeError):
    """Error of a network that cannot be loaded, or fails."""


class NoDeviceError(NetworkError):
    """Error of a provider that is installed, but finds no device."""


@dataclass(frozen=True)
class Provider:
    """One of onnxruntime's execution providers.

    Attributes
    ----------
    name : on the command line
    ort : onnxruntime's name of it
    package : the package that pip installs for it; "" for those of every onnxruntime
    plugin : the module with the path of the plug-in's library; "" where the provider is part of `package`'s onnxruntime
    settings : its options, so that it computes as the CPU does
    """

    name: str
    ort: str
    package: str = ""
    plugin: str = ""
    settings: Mapping[str, str] = field(default_factory=dict, hash=False)

    @property
    def built_in(self) -> bool:
        """Whether this onnxruntime was built with the provider."""
        return self.ort in _built_in()

    @property
    def installed(self) -> bool:
        """Whether the provider's libraries are there; a device need not be."""
        return self.built_in or bool(self.plugin and find_spec(self.plugin))

    def versions(self) -> list[str]:
        """Return the versions of onnxruntime and of the provider's package, for reports."""
        found = [f"onnxruntime {load_onnxruntime().__version__}"]
        if self.plugin:
            with suppress(PackageNotFoundError):
                found.append(f"{self.package} {version(self.package)}")
        return found


PACKAGED = Path(str(files("gffe_cl.engine.inference") / "weights" / "scn.onnx"))

CPU = Provider("cpu", "CPUExecutionProvider")
_KNOWN = (
    CPU,
    Provider("cuda", "CUDAExecutionProvider", "onnxruntime-gpu", settings={"use_tf32": "0"}),
    Provider("directml", "DmlExecutionProvider", "onnxruntime-directml"),
    Provider("openvino", "OpenVINOExecutionProvider", "onnxruntime-ep-openvino", "onnxruntime_ep_openvino"),
    Provider("webgpu", "WebGpuExecutionProvider", "onnxruntime-ep-webgpu", "onnxruntime_ep_webgpu"),
    Provider("coreml", "CoreMLExecutionProvider"),
    Provider("tensorrt", "TensorrtExecutionProvider", "onnxruntime-gpu"),
)
PROVIDERS: dict[str, Provider] = {provider.name: provider for provider in _KNOWN}

_sessions: WeakSet[Any] = WeakSet()  # of this process and those from which it was forked


def _leave_sessions() -> None:
    """Keep the sessions of the parent in a forked child for ever: releasing one waits for its threads, which are not
    there."""
    for session in _sessions:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(session))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_sessions)


def has_onnxruntime() -> bool:
    """Return whether onnxruntime is installed. Without it OpenCL kernels run the network."""
    return find_spec("onnxruntime") is not None


@cache
def load_onnxruntime() -> ModuleType:
    """Return onnxruntime without its telemetry and its log output. On import, telemetry would write an id of the
    device into the user's cache folder. No other function imports onnxruntime. Raises NetworkError where it is not
    installed."""
    if not has_onnxruntime():
        raise NetworkError("onnxruntime is not installed (expected: pip install onnxruntime, or the provider opencl)")
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    onnxruntime.set_default_logger_severity(4)  # failures raise
    return onnxruntime


def find_provider(name: str) -> Provider:
    """Return the provider of a key of `PROVIDERS` or of onnxruntime's own name. Raises NetworkError unless it is
    installed."""
    known = PROVIDERS.get(name.lower()) or next((each for each in _KNOWN if each.ort == name), None)
    if (provider := known or Provider(name, name)).installed:
        return provider
    there = [each.name for each in installed_providers()]
    hint = f"; pip install {provider.package}" if provider.package else ""
    raise NetworkError(
        f"provider '{name}' is not available in this onnxruntime (there is: {', '.join(there)}{hint})"
        if known
        else f"provider '{name}' is not available (there is: auto, {', '.join(there)})"
    )


def installed_providers() -> list[Provider]:
    """Return the known providers whose libraries are here."""
    return [provider for provider in _KNOWN if provider.installed]


def cpu_model(path: Path) -> Path:
    """Return the CPU's default file in place of `path`: for the package's own network its form in 8-bit integers,
    which takes half the time on a CPU and which GPUs do not support."""
    integers = path.with_name(f"{path.stem}-int8.onnx")
    return integers if path == PACKAGED and integers.is_file() else path


def open_session(path: Path, provider: Provider = CPU, sizes: Mapping[str, int] | None = None):
    """Return an onnxruntime.InferenceSession of the ONNX file `path`; no other function makes any. `sizes`: free
    dimensions of the model by name; with them, computations on sizes are folded, so that no node remains for the CPU.
    Raises NetworkError."""
    onnxruntime = load_onnxruntime()
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    for kind in ("intra_op", "inter_op"):
        options.add_session_config_entry(f"session.{kind}.allow_spinning", "0")
    options.log_severity_level = 4
    for name, size in (sizes or {}).items():
        options.add_free_dimension_override_by_name(name, size)
    arguments: dict[str, Any] = {"enable_fallback": 0}  # of Python, which prints
    if provider.built_in:
        names = [(provider.ort, dict(provider.settings))] + ([CPU.ort] if provider != CPU else [])
        arguments["providers"] = names
    else:
        options.add_provider_for_devices([plugin_device(provider)], dict(provider.settings))
    try:
        session = onnxruntime.InferenceSession(model_source(path), options, **arguments)
    except Exception as error:  # onnxruntime's classes have no common base
        if provider != CPU:
            raise NetworkError(f"provider {provider.name}: cannot be used: {one_line(error)}") from None
        raise NetworkError(f"{path}: cannot be loaded (expected an ONNX model): {one_line(error)}") from None
    if provider.ort not in session.get_providers():
        raise NoDeviceError(f"provider {provider.name}: does not work here (expected its libraries and a device)")
    _sessions.add(session)
    return session


def plugin_device(provider: Provider):
    """Return the device of a plug-in, preferably a GPU. Raises NetworkError if there is none."""
    try:
        _register(provider)
        found = [device for device in load_onnxruntime().get_ep_devices() if device.ep_name == provider.ort]
    except Exception as error:
        raise NetworkError(f"provider {provider.name}: its plug-in cannot be loaded: {one_line(error)}") from None
    if not found:
        raise NoDeviceError(f"provider {provider.name}: no device (expected a supported GPU and its driver)")
    return min(found, key=lambda device: ("GPU", "NPU", "CPU").index(device.device.type.name))


@cache
def _built_in() -> frozenset[str]:
    """Return the names of the providers that are part of onnxruntime. Call it before any plug-in is registered:
    onnxruntime lists those, too, from then on."""
    return frozenset(load_onnxruntime().get_available_providers())


@cache
def _register(provider: Provider) -> None:
    _built_in()
    library = importlib.import_module(provider.plugin).get_library_path()
    load_onnxruntime().register_execution_provider_library(f"gffe-{provider.name}", library)


def one_line(error: Exception) -> str:
    """Return the end of onnxruntime's message, which names the cause, in one line of at most 200 characters."""
    text = " ".join(str(error).replace("\\n", " ").split())
    return text if len(text) <= 200 else f"… {text[-198:]}"
