"""Hypotheses about how cameras, depth and motion vectors are meant, and the search for those that fit."""
