"""The built-in scenes, one module each."""
