"""The environments of one and of many vehicles, their wrappers, and the simulation on tensors."""
