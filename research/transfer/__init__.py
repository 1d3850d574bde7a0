"""Other simulators: vehicles of six degrees of freedom that unchanged policies steer, and what they do there."""
