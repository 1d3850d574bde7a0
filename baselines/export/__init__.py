"""Export of trained agents as ONNX models and C headers, generated from the equations of the agents."""
