"""A view of a vehicle beside its path, and the colours of a picture."""

import numpy as np

from auv_gym.rendering import View

SIZE = (480, 360)
VIEW = View(
    time=3.0,
    state=(-1.5, 0.5, 0.0, 0.1, 0.0, 0.0),
    reference=(1.5, 0.5, 0.3),
    path=np.column_stack((np.linspace(-20.0, 20.0, 200), np.full(200, 0.5))),
    travelled=107,
    trail=np.column_stack((np.linspace(-4.0, -1.5, 30), np.full(30, 0.5))),
    current=(0.0, 0.0),
    force=(7.0, -0.5),
    force_limits=(200.0, 50.0),
    position_error=3.0,
    title="paper-circle",
)


def count(array, color, tolerance=12):
    """Return the number of pixels of about this colour."""
    return int((np.abs(array.astype(int) - color).max(axis=-1) <= tolerance).sum())
