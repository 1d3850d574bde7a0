"""Exported agents on an emulated microcontroller and in ONNX Runtime: accuracy, time and memory."""
