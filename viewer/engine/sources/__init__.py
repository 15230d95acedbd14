"""Sources of frames: sequences on disk and built-in scenes."""
