"""Engine: the part that a renderer links. Devices, the pipeline of stages, networks, pacing, the export to C."""
