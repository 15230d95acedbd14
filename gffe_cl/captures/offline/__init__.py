"""Whole sequences through the pipeline (`gffe run`)."""
