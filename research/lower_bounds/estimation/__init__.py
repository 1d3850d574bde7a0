"""The floor that measurement noise lays: how near to its reference a vehicle can be kept that must first be located."""
