"""The viewer without a user: scripts and films, screenshots, measured playback."""
