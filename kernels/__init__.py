"""OpenCL C sources of the stages: one file per stage, `common.h` shared by all."""
