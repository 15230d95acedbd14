"""The pipeline: its options, the order and state of its stages, what it extrapolates from, and `gffe run`."""
