"""Cameras for captures that have none, from depth and motion vectors (`gffe calibrate`)."""
