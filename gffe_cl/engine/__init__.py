"""The part that a renderer links: devices, the pipeline of stages, networks, pacing, the export to C."""
