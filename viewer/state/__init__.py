"""State of the viewer and choices of the user; no ImGui here."""
