"""Measurement of any pipeline: times of its stages, and bytes that they must move."""
