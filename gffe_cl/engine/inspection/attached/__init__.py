"""Attached programs: the side of the program, the side of the viewer, and their messages."""
