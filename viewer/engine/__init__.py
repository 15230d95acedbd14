"""Computation: the engine thread, its sources of frames, and its buffers."""
