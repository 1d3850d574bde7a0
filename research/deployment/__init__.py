"""Exported policies on an emulated microcontroller and in ONNX Runtime: same actions, time, memory."""
