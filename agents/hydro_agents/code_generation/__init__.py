"""Code for other tools: C99 and FMU of the plant, ONNX and C99 of the controllers, generated from their Python."""
