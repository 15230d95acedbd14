"""Hypotheses about the conventions of cameras, depth and motion vectors, and the search for those that fit."""
