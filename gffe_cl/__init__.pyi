"""What type checkers and editors see of the package, whose modules are loaded on first use."""

from gffe_cl.captures.doctor.diagnose import check as check
from gffe_cl.captures.formats import open_capture as open_capture
from gffe_cl.captures.offline.recording import record as record
from gffe_cl.captures.sequence import FrameEntry as FrameEntry
from gffe_cl.captures.sequence import Sequence as Sequence
from gffe_cl.captures.sequence import SequenceWriter as SequenceWriter
from gffe_cl.captures.sequence import named_channels as named_channels
from gffe_cl.captures.sequence import open_sequence as open_sequence
from gffe_cl.engine.core.errors import GffeError as GffeError
from gffe_cl.engine.frame.camera import Camera as Camera
from gffe_cl.engine.frame.camera import predict_camera as predict_camera
from gffe_cl.engine.frame.camera_prediction import predict_camera_at as predict_camera_at
from gffe_cl.engine.frame.conventions import depth_from_device as depth_from_device
from gffe_cl.engine.frame.conventions import depth_from_distance as depth_from_distance
from gffe_cl.engine.frame.conventions import motion_from_ndc as motion_from_ndc
from gffe_cl.engine.frame.conventions import motion_from_unreal as motion_from_unreal
from gffe_cl.engine.frame.conventions import motion_from_uv as motion_from_uv
from gffe_cl.engine.frame.frame_format import FrameFormat as FrameFormat
from gffe_cl.engine.frame.rendered_frame import BadPixels as BadPixels
from gffe_cl.engine.frame.rendered_frame import Overlays as Overlays
from gffe_cl.engine.frame.rendered_frame import RenderedFrame as RenderedFrame
from gffe_cl.engine.frame.transfer_function import to_display as to_display
from gffe_cl.engine.frame.window import Jitter as Jitter
from gffe_cl.engine.frame.window import Window as Window
from gffe_cl.engine.frame.window import adaptive_window as adaptive_window
from gffe_cl.engine.frame.window import fixed_window as fixed_window
from gffe_cl.engine.frame.window import nearest_depth as nearest_depth
from gffe_cl.engine.opencl.device import Device as Device
from gffe_cl.engine.opencl.device import DeviceInfo as DeviceInfo
from gffe_cl.engine.opencl.device import list_devices as list_devices
from gffe_cl.engine.opencl.device import open_device as open_device
from gffe_cl.engine.opencl.runtimes import prepare_runtimes as prepare_runtimes
from gffe_cl.engine.opencl.sharing import MemorySharing as MemorySharing
from gffe_cl.engine.opencl.sharing import SharingSupport as SharingSupport
from gffe_cl.engine.opencl.sharing import sharing_support as sharing_support
from gffe_cl.engine.options import OPTIONS as OPTIONS
from gffe_cl.engine.options import Options as Options
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame as ExtrapolatedFrame
from gffe_cl.engine.pipeline.made_frame import PresentedFrame as PresentedFrame
from gffe_cl.engine.pipeline.pacing import Pacer as Pacer
from gffe_cl.engine.pipeline.pipeline import Pipeline as Pipeline
from gffe_cl.engine.stages.presentation import present as present
from gffe_cl.lab.metrics import psnr as psnr
from gffe_cl.lab.metrics import ssim as ssim

__version__: str
__all__: list[str]
