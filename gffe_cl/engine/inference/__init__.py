"""Networks run by onnxruntime: sessions, execution providers, their check against the CPU."""
