"""Frames as renderers give them: cameras, buffers, jitter, adaptive windows, conventions of graphics APIs."""
