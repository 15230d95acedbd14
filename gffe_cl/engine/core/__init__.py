"""The exception class, checks of input values, and file handling. All other packages build on it."""
