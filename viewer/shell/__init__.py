"""The window: docked panels, actions, keys, theme, and windows over the panels."""
