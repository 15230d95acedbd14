"""Attached programs: their own side, and the messages between them and a viewer."""
