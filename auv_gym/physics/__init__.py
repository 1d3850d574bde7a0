"""Equations of motion, actuators, sensors and disturbances, for floats, arrays, tensors and traced symbols."""
