"""What the viewer knows and what the user has chosen; no ImGui here."""
