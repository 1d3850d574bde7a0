"""Pictures of a vehicle and its reference: x to the right, y up, angles counter-clockwise, as in the paper's plots.

`Renderer.draw` draws a picture of a `View` (SI units), in space with a second one from the side, see `two_planes`. Blue
is the reference, orange the vehicle, sky blue the current, vermilion the error and saturation. pygame is imported when
a `Renderer` is made.
"""

from auv_gym.rendering.camera import View
from auv_gym.rendering.canvas import PICTURE
from auv_gym.rendering.planes import Plane, two_planes
from auv_gym.rendering.renderer import Renderer, checked_size

__all__ = ["PICTURE", "Plane", "Renderer", "View", "checked_size", "two_planes"]
