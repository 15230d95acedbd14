"""The viewer without a user: scripts, films and screenshots."""
