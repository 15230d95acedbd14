"""The pipeline: the order and state of its stages, the frames it makes, and pacing."""
