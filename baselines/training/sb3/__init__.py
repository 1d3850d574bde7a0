"""Train with Stable-Baselines3 on the vector environment of the package."""
