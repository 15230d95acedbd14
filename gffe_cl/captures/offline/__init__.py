"""Extrapolation of whole sequences (`gffe run`)."""
