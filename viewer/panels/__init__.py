"""The viewer's panels: each module has `draw(app)`, called inside its window in every frame of the interface."""
