"""Sessions of onnxruntime on the CPU."""

from __future__ import annotations

import ctypes
import os
from functools import cache
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


CPU = "CPUExecutionProvider"  # onnxruntime's name of what runs a session
PACKAGED = Path(str(files("gffe_cl.engine.inference") / "weights" / "scn.onnx"))

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


def cpu_model(path: Path) -> Path:
    """Return the file that runs in place of `path`: for the package's own network its form in 8-bit integers, which
    takes half the time on a CPU."""
    integers = path.with_name(f"{path.stem}-int8.onnx")
    return integers if path == PACKAGED and integers.is_file() else path


def open_session(path: Path):
    """Return an onnxruntime.InferenceSession of the ONNX file `path`; no other function makes any. Raises
    NetworkError."""
    onnxruntime = load_onnxruntime()
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    for kind in ("intra_op", "inter_op"):
        options.add_session_config_entry(f"session.{kind}.allow_spinning", "0")
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(model_source(path), options, providers=[CPU])
    except Exception as error:  # onnxruntime's classes have no common base
        raise NetworkError(f"{path}: cannot be loaded (expected an ONNX model): {one_line(error)}") from None
    _sessions.add(session)
    return session


def one_line(error: Exception) -> str:
    """Return the end of onnxruntime's message, which names the cause, in one line of at most 200 characters."""
    text = " ".join(str(error).replace("\\n", " ").split())
    return text if len(text) <= 200 else f"… {text[-198:]}"
