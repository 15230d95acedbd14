"""gffe-cl: G-buffer free frame extrapolation (GFFE) in portable OpenCL.

import gffe_cl as gffe

pipeline = gffe.Pipeline(gffe.open_device(), width, height)
pipeline.submit(gffe.RenderedFrame(color, depth, motion, camera, time))
frame = pipeline.extrapolate(next_camera, next_time)
frame.color                 # device buffer
frame.numpy("color")        # NumPy array
"""

from importlib import import_module

from gffe_cl.gone import removal

__version__ = "0.2.0"

# Loaded on first use: importing the package must not load a driver.
_HOME = {
    "Camera": "engine.frame.camera",
    "predict_camera": "engine.frame.camera",
    "predict_camera_at": "engine.frame.camera_prediction",
    "depth_from_device": "engine.frame.conventions",
    "depth_from_distance": "engine.frame.conventions",
    "motion_from_ndc": "engine.frame.conventions",
    "motion_from_uv": "engine.frame.conventions",
    "motion_from_unreal": "engine.frame.conventions",
    "FrameFormat": "engine.frame.frame_format",
    "Device": "engine.opencl.device",
    "DeviceInfo": "engine.opencl.device",
    "list_devices": "engine.opencl.device",
    "open_device": "engine.opencl.device",
    "prepare_runtimes": "engine.opencl.runtimes",
    "SharingSupport": "engine.opencl.sharing",
    "sharing_support": "engine.opencl.sharing",
    "MemorySharing": "engine.opencl.sharing",
    "GffeError": "engine.core.errors",
    "BadPixels": "engine.frame.rendered_frame",
    "Overlays": "engine.frame.rendered_frame",
    "RenderedFrame": "engine.frame.rendered_frame",
    "ExtrapolatedFrame": "engine.pipeline.made_frame",
    "Options": "engine.options",
    "OPTIONS": "engine.options",
    "Pipeline": "engine.pipeline.pipeline",
    "PresentedFrame": "engine.pipeline.made_frame",
    "open_capture": "captures.formats",
    "FrameEntry": "captures.sequence",
    "Sequence": "captures.sequence",
    "SequenceWriter": "captures.sequence",
    "named_channels": "captures.sequence",
    "open_sequence": "captures.sequence",
    "present": "engine.stages.presentation",
    "record": "captures.offline.recording",
    "Pacer": "engine.pipeline.pacing",
    "check": "captures.doctor.quick",
    "psnr": "lab.metrics",
    "ssim": "lab.metrics",
    "to_display": "engine.frame.transfer_function",
    "Window": "engine.frame.window",
    "adaptive_window": "engine.frame.window",
    "fixed_window": "engine.frame.window",
    "nearest_depth": "engine.frame.window",
    "Jitter": "engine.frame.window",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name):
    if name not in _HOME:
        if removed := removal(name):
            raise import_module("gffe_cl.engine.core.errors").GffeError(removed)
        raise AttributeError(f"module 'gffe_cl' has no attribute '{name}'")
    value = getattr(import_module(f"gffe_cl.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__():
    return sorted(set(globals()) | set(__all__))
