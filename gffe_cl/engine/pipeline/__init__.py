"""The pipeline: its options, the order and state of its stages, its input frames, and `gffe run`."""
