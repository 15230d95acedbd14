"""What computes: the engine thread, where its frames come from, and what its buffers hold."""
