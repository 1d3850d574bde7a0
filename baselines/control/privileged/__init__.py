"""Reference policies with full information: the true state and all present and future disturbances."""
