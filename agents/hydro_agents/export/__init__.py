"""Plant, controllers and leakage head as C99, FMU, ONNX and as the playground page."""
