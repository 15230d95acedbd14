"""The stages of geometry-aware extrapolation: one module per kernel file."""
