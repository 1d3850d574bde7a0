"""Train agents: analytic policy gradient and Stable-Baselines3."""
