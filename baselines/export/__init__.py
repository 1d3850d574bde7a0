"""Trained agents for programs without this package: ONNX models and C headers, printed from the same equations."""
