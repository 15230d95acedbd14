"""Captures of other programs, read as sequences of our own."""

from gffe_cl.captures.formats.registry import FORMATS, Format, captures_in, open_capture

__all__ = ["FORMATS", "Format", "captures_in", "open_capture"]
