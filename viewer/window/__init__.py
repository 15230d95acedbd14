"""The window and its panels: the module of a panel has `draw(app)`, called in every frame of the interface."""
