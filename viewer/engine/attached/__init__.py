"""Looking into a running program: what works in the program, what the viewer has of it, and how they talk."""
