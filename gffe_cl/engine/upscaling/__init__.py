"""Upscaling: small, jittered rendered frames, gathered over time at the display's size (docs/upscaling.md)."""
