"""gffe-cl: G-buffer free frame extrapolation (GFFE) in portable OpenCL.

import gffe_cl as gffe

pipeline = gffe.Pipeline(gffe.open_device(), width, height)
pipeline.submit(gffe.RenderedFrame(color, depth, motion, camera, time))
frame = pipeline.extrapolate(next_camera, next_time)
frame.color                 # device buffer
frame.numpy("color")        # NumPy array
"""

from importlib import import_module

__version__ = "0.2.0"

# Loaded on first use: importing the package must not load a driver.
_HOME = {
    "Camera": "frame.camera",
    "predict_camera": "frame.camera",
    "predict_camera_at": "frame.camera_prediction",
    "depth_from_device": "frame.conventions",
    "depth_from_distance": "frame.conventions",
    "motion_from_ndc": "frame.conventions",
    "motion_from_uv": "frame.conventions",
    "motion_from_unreal": "frame.conventions",
    "Device": "opencl.device",
    "DeviceInfo": "opencl.device",
    "list_devices": "opencl.device",
    "open_device": "opencl.device",
    "prepare_runtimes": "opencl.runtimes",
    "SharingSupport": "opencl.sharing",
    "sharing_support": "opencl.sharing",
    "GlSharing": "opencl.sharing",
    "MemorySharing": "opencl.sharing",
    "GffeError": "core.errors",
    "BadPixels": "frame.rendered_frame",
    "Overlays": "frame.rendered_frame",
    "RenderedFrame": "frame.rendered_frame",
    "pack_frame": "frame.rendered_frame",
    "ExtrapolatedFrame": "pipeline.made_frame",
    "Options": "pipeline.options",
    "OPTIONS": "pipeline.options",
    "Pipeline": "pipeline.pipeline",
    "PresentedFrame": "pipeline.made_frame",
    "open_capture": "formats",
    "FrameEntry": "sequence",
    "Sequence": "sequence",
    "SequenceWriter": "sequence",
    "named_channels": "sequence",
    "open_sequence": "sequence",
    "present": "stages.presentation",
    "Pacer": "pipeline.pacing",
    "check": "doctor.quick",
    "psnr": "evaluation.metrics",
    "ssim": "evaluation.metrics",
    "to_display": "frame.transfer_function",
    "Window": "frame.window",
    "adaptive_window": "frame.window",
    "fixed_window": "frame.window",
    "nearest_depth": "frame.window",
    "Jitter": "frame.jitter",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name):
    if name not in _HOME:
        raise AttributeError(f"module 'gffe_cl' has no attribute '{name}'")
    value = getattr(import_module(f"gffe_cl.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__():
    return sorted(set(globals()) | set(__all__))
