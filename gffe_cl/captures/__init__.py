"""Captures: pictures in and out. Sequences on disk, other programs' captures, built-in scenes, `gffe run`, the
doctor."""
