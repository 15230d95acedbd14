"""The exception, checks of values from outside, and files: what every other room builds on."""
