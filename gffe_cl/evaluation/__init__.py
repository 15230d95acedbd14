"""Measuring: sequences against the truth, methods on built-in scenes, time and memory."""
