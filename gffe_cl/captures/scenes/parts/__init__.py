"""Parts that scenes are made of: figures, furniture, lights, vehicles, motions."""
