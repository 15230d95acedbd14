"""Sequences on disk: a folder with `sequence.json` and one OpenEXR file per frame."""

from gffe_cl.captures.sequence.description import FrameEntry
from gffe_cl.captures.sequence.output_folder import refuse_same_folder
from gffe_cl.captures.sequence.reader import Sequence, open_sequence, require_clean
from gffe_cl.captures.sequence.writer import SequenceWriter, named_channels

__all__ = [
    "FrameEntry",
    "Sequence",
    "SequenceWriter",
    "named_channels",
    "open_sequence",
    "refuse_same_folder",
    "require_clean",
]
