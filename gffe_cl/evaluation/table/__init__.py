"""The table of `gffe eval`: every method on every sequence, in cells that are kept by what they are made of."""
