"""Explanation of a pixel: the stages that made it, and the trail of its fragment."""
