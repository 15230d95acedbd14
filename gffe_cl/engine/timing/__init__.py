"""Times of stages and bytes that must move, of any pipeline."""
