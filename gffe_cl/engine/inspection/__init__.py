"""A pipeline looked into: its layers, and the values and the story of a pixel."""
