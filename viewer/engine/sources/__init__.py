"""Sources of frames: sequences on disk, built-in scenes, previews."""
