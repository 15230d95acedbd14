"""A pipeline looked into: its layers, the values and the story of a pixel, and `attach` for other processes."""
