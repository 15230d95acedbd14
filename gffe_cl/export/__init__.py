"""The pipeline as C for engines (`gffe export`)."""

from gffe_cl.export.frames import write_frames
from gffe_cl.export.writing import export

__all__ = ["export", "write_frames"]
