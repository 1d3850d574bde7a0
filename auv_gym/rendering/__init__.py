"""Pictures of a tracking vehicle: x to the right, y up, angles counter-clockwise, as in the paper's plots.

`Renderer.draw` turns one `View` (SI units) into one picture. Colours carry meaning: blue is the plan, orange the
vehicle, sky blue the current, vermilion the error and saturation. pygame is imported when a `Renderer` is made.
"""

from auv_gym.rendering.camera import View
from auv_gym.rendering.canvas import PICTURE
from auv_gym.rendering.renderer import Renderer, checked_size

__all__ = ["PICTURE", "Renderer", "View", "checked_size"]
