"""The shading correction network: read for OpenCL kernels, or run by onnxruntime."""
