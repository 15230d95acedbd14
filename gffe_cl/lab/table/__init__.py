"""The table of `gffe eval`: every method on every sequence. Cells are cached by a hash of their inputs."""
