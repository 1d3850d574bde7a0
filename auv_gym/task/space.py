"""Motion in space as a kind of motion for the simulation: `SPACE`, the second instance of `model.Model`.

Its state, load and errors are those of `auv_gym.physics.space`, where signs are explained: z is up, positive theta and
q are nose down. The channels are surge, pitch and yaw.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, NamedTuple

from auv_gym.effects.actuators import Response
from auv_gym.physics import space
from auv_gym.physics.namespaces import Namespace, Number, sum_of
from auv_gym.physics.space import SpaceCoefficients, axes
from auv_gym.task.model import Model, plant_of, sample_of
from auv_gym.task.observation import L, V, W


class ReferencePoint(NamedTuple):
    """The reference at one time."""

    x: float  # [m]
    y: float  # [m]
    z: float  # [m]
    theta: float  # [rad]
    psi: float  # [rad]
    u: float  # [m/s]
    v: float  # [m/s]
    w: float  # [m/s]
    q: float  # [rad/s]
    r: float  # [rad/s]
    F_u: float  # [N]
    F_q: float  # [N m]
    F_r: float  # [N m]


_CURRENT, _LOAD = ("V_x", "V_y", "V_z"), ("X", "Y", "Z", "M", "N")
Plant, Sample = plant_of(ReferencePoint, __name__), sample_of(ReferencePoint, _CURRENT, _LOAD, __name__)
"""Plant and sample of motion in space."""


class SpaceResponse(NamedTuple):
    """One control step of the actuators, see `effects.actuators.Response`; pitch is as fast as yaw."""

    gain: Number
    mean: Number
    slew_u: Number  # [N] largest change in one step
    slew_q: Number  # [N m]
    slew_r: Number  # [N m]

    @classmethod
    def of(cls, response: Response) -> SpaceResponse:
        """Return the response for that of surge and yaw."""
        return cls(*response, response.slew_r)


class Parameters(NamedTuple):
    """The constants of an episode: floats, or rows of shape (N,)."""

    h: Number  # [s] integration step
    coefficients: SpaceCoefficients  # of the true vehicle
    F_u_max: Number  # [N] force that action 1 commands, as observed
    F_q_max: Number  # [N m]
    F_r_max: Number  # [N m]
    response: SpaceResponse
    error_scale: Number  # [m]
    rate_weight: Number
    lost_distance: Number  # [m]
    thrust_u: Number  # [N] true force at action 1
    thrust_q: Number  # [N m]
    thrust_r: Number  # [N m]
    parts: Any = None  # `simulation.Parts`
    own: tuple[Number, ...] = ()  # constants of the effects, rows after the others


class Observation(NamedTuple):
    """A decoded observation in SI units: floats, or arrays of shape (N,). Annotations hold the fields of its `Term`."""

    e_x: Annotated[Number, "m", 1.0, L, "measured position error along the axis of the body"]
    e_y: Annotated[Number, "m", 1.0, L, "measured position error to port"]
    e_z: Annotated[Number, "m", 1.0, L, "measured position error along the body's upward axis"]
    theta_e: Annotated[Number, "rad", 0.5, 2 * math.pi, "measured error of the axis in pitch, positive nose down"]
    psi_e: Annotated[Number, "rad", 0.5, 2 * math.pi, "measured error of the axis in yaw"]
    u_e: Annotated[Number, "m/s", 0.5, V / 0.5, "measured surge velocity error, over ground"]
    v_e: Annotated[Number, "m/s", 0.5, V / 0.5, "measured sway velocity error, over ground"]
    w_e: Annotated[Number, "m/s", 0.5, V / 0.5, "measured heave velocity error, over ground"]
    q_e: Annotated[Number, "rad/s", 0.125, W / 0.125, "measured pitch rate error"]
    r_e: Annotated[Number, "rad/s", 0.125, W / 0.125, "measured yaw rate error"]
    theta_R: Annotated[Number, "rad", 0.5, math.pi, "reference pitch"]
    u_R: Annotated[Number, "m/s", 0.5, V / 0.5, "reference surge velocity"]
    v_R: Annotated[Number, "m/s", 0.5, V / 0.5, "reference sway velocity"]
    w_R: Annotated[Number, "m/s", 0.5, V / 0.5, "reference heave velocity"]
    q_R: Annotated[Number, "rad/s", 0.125, W / 0.125, "reference pitch rate"]
    r_R: Annotated[Number, "rad/s", 0.125, W / 0.125, "reference yaw rate"]
    F_uR: Annotated[Number, "N", 128.0, 64.0, "reference surge force"]
    F_qR: Annotated[Number, "N m", 64.0, 64.0, "reference pitch moment"]
    F_rR: Annotated[Number, "N m", 64.0, 64.0, "reference yaw moment"]
    cos_theta: Annotated[Number, "1", 1.0, 1.0, "cosine of the measured pitch"]
    sin_theta: Annotated[Number, "1", 1.0, 1.0, "sine of the measured pitch"]
    cos_psi: Annotated[Number, "1", 1.0, 1.0, "cosine of the measured heading"]
    sin_psi: Annotated[Number, "1", 1.0, 1.0, "sine of the measured heading"]
    depth: Annotated[Number, "m", 16.0, 64.0, "measured depth below the surface"]
    F_u_max: Annotated[Number, "N", 128.0, 64.0, "surge force that action 1 commands"]
    F_q_max: Annotated[Number, "N m", 64.0, 64.0, "pitch moment that action 1 commands"]
    F_r_max: Annotated[Number, "N m", 64.0, 64.0, "yaw moment that action 1 commands"]
    a_u: Annotated[Number, "1", 1.0, 1.0, "previous action, surge"]
    a_q: Annotated[Number, "1", 1.0, 1.0, "previous action, pitch"]
    a_r: Annotated[Number, "1", 1.0, 1.0, "previous action, yaw"]
    dt: Annotated[Number, "s", 0.125, 80.0, "control period"]


def _over_ground(state: Sequence[Number], current: Sequence[Number], ns: Namespace) -> tuple[Number, ...]:
    u, v, w, *rates = state[5:]
    body = axes(state[3], state[4], ns)
    drift = (sum_of(a * b for a, b in zip(axis, current, strict=True)) for axis in body)
    return *state[:5], *(a + b for a, b in zip((u, v, w), drift, strict=True)), *rates


def _terms(
    errors: Sequence[Number],
    measured: Sequence[Number],
    reference: Sequence[Number],
    limits: Sequence[Number],
    action: Sequence[Number],
    dt: Number,
    ns: Namespace,
) -> tuple[Number, ...]:
    _, _, _, theta_R, _, *wanted = reference
    angles = (f(measured[k]) for k in (3, 4) for f in (ns.cos, ns.sin))
    return *errors, theta_R, *wanted, *angles, -measured[2], *limits, *action, dt


def measured_axes(o: Observation) -> tuple[tuple[Number, Number, Number], ...]:
    """Return the measured body axes ahead, to port and up in the world."""
    c, s, cp, sp = o.cos_theta, o.sin_theta, o.cos_psi, o.sin_psi
    return (c * cp, c * sp, -s), (-sp, cp, 0.0 * cp), (s * cp, s * sp, c)


def in_body_frame(vector: Iterable[Number], o: Observation) -> tuple[Number, ...]:
    """Return a vector of the world along the measured body axes."""
    numbers = tuple(vector)
    return tuple(sum_of(a * b for a, b in zip(axis, numbers, strict=True)) for axis in measured_axes(o))


def in_world(vector: Iterable[Number], o: Observation) -> tuple[Number, ...]:
    """Return a vector along the measured body axes in the world."""
    columns, numbers = zip(*measured_axes(o), strict=True), tuple(vector)
    return tuple(sum_of(a * b for a, b in zip(column, numbers, strict=True)) for column in columns)


def _displaced(ahead: Sequence[Number], o: Observation, _: Namespace) -> tuple[Number, ...]:
    return in_body_frame(ahead, o)


SPACE = Model(
    name="space",
    Plant=Plant,
    Sample=Sample,
    Reference=ReferencePoint,
    Parameters=Parameters,
    Observation=Observation,
    channels=("u", "q", "r"),
    driven=("X", "M", "N"),
    position=("x", "y", "z"),
    velocity=("u", "v", "w"),
    current=_CURRENT,
    load=_LOAD,
    advance=space.rk4_step,
    from_outside=space.load_from_outside,
    over_ground=_over_ground,
    errors=space.tracking_errors,
    terms=_terms,
    displaced=_displaced,
)
"""Motion in space."""
