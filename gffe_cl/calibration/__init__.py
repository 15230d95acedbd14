"""Cameras of captures that have none, from depth and motion vectors alone (`gffe calibrate`)."""
