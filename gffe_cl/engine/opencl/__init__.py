"""OpenCL: runtimes, devices, and building and launching kernels."""
