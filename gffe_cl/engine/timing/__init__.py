"""Measurement of any pipeline: times of its stages, and their memory."""
