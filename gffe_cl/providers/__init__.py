"""What runs networks: onnxruntime's execution providers, compared with the CPU before they are trusted."""
