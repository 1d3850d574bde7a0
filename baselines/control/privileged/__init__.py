"""Reference policies with full information: they see the true state and all disturbances, now and in future."""
