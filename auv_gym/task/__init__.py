"""One control step: simulation, observation, reward, preview, and the interface of a policy."""
