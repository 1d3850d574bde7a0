"""Trained agents: what they are on disk, what they see, how they act."""
