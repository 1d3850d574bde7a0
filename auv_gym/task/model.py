"""What the simulation takes from a kind of motion: states, actuators, inputs, observation and equations.

Sizes and rows of all arrays follow from it. `PLANE` is motion in the horizontal plane with a surge force and a yaw
torque.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from auv_gym.effects.actuators import Response
from auv_gym.physics.dynamics import CurrentVelocity, State, from_outside, rk4_step
from auv_gym.physics.errors import to_body, tracking_errors
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.rows import flatten, numbered
from auv_gym.physics.vehicle import Coefficients
from auv_gym.task.observation import Layout, Observation


class ReferencePoint(NamedTuple):
    """The reference at one time."""

    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad]
    u: float  # [m/s]
    v: float  # [m/s]
    r: float  # [rad/s]
    F_u: float  # [N]
    F_r: float  # [N m]


def plant_of(reference: Any, module: str) -> Any:
    """Return the NamedTuple of the states of vehicle, actuators and memory at one control instant, in a module.

    Its numbers are those of a reference, with velocities relative to the water and the forces of the actuators, then
    the last action a_c of each channel; floats, arrays (N,) or tensors. `memory` is that of the effects in use, rows
    after the others.
    """
    last = [name.replace("F_", "a_") for name in reference._fields if name.startswith("F_")]
    return namedtuple("Plant", (*reference._fields, *last, "memory"), defaults=((),), module=module)


def sample_of(reference: Any, current: Sequence[str], load: Sequence[str], module: str) -> Any:
    """Return the NamedTuple of the exogenous inputs at one control instant, in a module.

    They are the reference, the current [m/s], the external load [N], [N m], and the errors n_c of the measured state,
    in the units of the reference. Current and load act over the period that ends there. The current is the one without
    shear, in space at the depth of the first reference.
    """
    noise = (f"n_{name}" for name in reference._fields if not name.startswith("F_"))
    names = (f"{name}R" if name.startswith("F_") else f"{name}_R" for name in reference._fields)
    return namedtuple("Sample", (*names, *current, *load, *noise), module=module)


Plant, Sample = plant_of(ReferencePoint, __name__), sample_of(ReferencePoint, ("V_x", "V_y"), ("X", "Y", "N"), __name__)
"""Plant and sample of motion in the plane."""


class Parameters(NamedTuple):
    """The constants of an episode: floats, or rows of shape (N,)."""

    h: Number  # [s] integration step
    coefficients: Coefficients  # of the true vehicle
    F_u_max: Number  # [N] force that action 1 commands, as observed
    F_r_max: Number  # [N m]
    response: Response
    error_scale: Number  # [m]
    rate_weight: Number
    lost_distance: Number  # [m]
    thrust_u: Number  # [N] true force at action 1
    thrust_r: Number  # [N m]
    parts: Any = None  # `simulation.Parts`
    own: tuple[Number, ...] = ()  # constants of the effects, rows after the others


@dataclass(frozen=True)
class Model:
    """A kind of motion.

    Attributes:
        name: of the model.
        Plant: NamedTuple of the state, then F_c and a_c for each channel c, then `memory`.
        Sample: NamedTuple of the reference of state and forces, then current, load, and errors of the measured state.
        Reference: NamedTuple of state and forces of the reference, as users get it.
        Parameters: NamedTuple with F_c_max and thrust_c for each channel c, and the other fields of `Parameters`.
        Observation: NamedTuple of the terms, as `observation.Observation`.
        channels: names of the actuators.
        driven: the component of the load on which each actuator acts.
        position: names of the coordinates of the position, the first ones of the state.
        velocity: names of the velocities through water that a log measures over ground.
        current: names of the components of the current in a sample.
        load: names of the components of the load in a sample.
        advance: returns the state after a time with load and current held, as `dynamics.rk4_step`.
        from_outside: returns a load from outside as a part of that of `advance`, as `dynamics.from_outside`.
        over_ground: returns the state with velocities over ground, from (state, current, ns).
        errors: returns the tracking errors, as `errors.tracking_errors`.
        terms: returns the terms of an observation, from (errors, measured state, reference, limits, action, dt, ns).
        displaced: returns a displacement in the world along the measured body axes, from (it, observation, ns).
    """

    name: str
    Plant: Any
    Sample: Any
    Reference: Any
    Parameters: Any
    Observation: Any
    channels: tuple[str, ...]
    driven: tuple[str, ...]
    position: tuple[str, ...]
    velocity: tuple[str, ...]
    current: tuple[str, ...]
    load: tuple[str, ...]
    advance: Callable[..., Any]
    from_outside: Callable[..., Any]
    over_ground: Callable[..., Any]
    errors: Callable[..., Any]
    terms: Callable[..., tuple[Number, ...]]
    displaced: Callable[..., tuple[Number, ...]]

    @cached_property
    def state(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(self.Plant._fields[: -1 - 2 * len(self.channels)])

    @cached_property
    def forces(self) -> slice:
        """Rows of the forces in a plant."""
        return slice(len(self.state), len(self.state) + len(self.channels))

    @cached_property
    def plant(self) -> Any:
        """Index of each number of a plant."""
        return numbered(self.Plant)

    @cached_property
    def sample(self) -> Any:
        """Index of each number of a sample."""
        return numbered(self.Sample)

    @cached_property
    def parameters(self) -> Any:
        """Index of each number of the parameters."""
        return numbered(self.Parameters)

    @cached_property
    def plant_rows(self) -> int:
        """Number of rows of a plant without effects."""
        return len(self.Plant._fields) - 1

    @cached_property
    def sample_rows(self) -> int:
        """Number of rows of a sample without effects."""
        return len(self.Sample._fields)

    @cached_property
    def parameter_rows(self) -> int:
        """Number of rows of the parameters without effects."""
        return len(flatten(self.parameters))

    @cached_property
    def layout(self) -> Layout:
        """How its observation is encoded."""
        return Layout.of(self.Observation)

    @cached_property
    def reference(self) -> slice:
        """Rows of the reference in a sample: its state, then its forces."""
        return slice(0, len(self.state) + len(self.channels))

    @cached_property
    def current_rows(self) -> slice:
        """Rows of the current in a sample."""
        return slice(self.reference.stop, self.reference.stop + len(self.current))

    @cached_property
    def load_rows(self) -> slice:
        """Rows of the external load in a sample."""
        return slice(self.current_rows.stop, self.current_rows.stop + len(self.load))

    @cached_property
    def noise_rows(self) -> slice:
        """Rows of the measurement errors in a sample."""
        return slice(self.load_rows.stop, self.load_rows.stop + len(self.state))

    def limits(self, p: Any) -> tuple[Number, ...]:
        """Return the nominal limits [N], [N m] of the channels."""
        return tuple(getattr(p, f"F_{c}_max") for c in self.channels)

    def thrusts(self, p: Any) -> tuple[Number, ...]:
        """Return the true forces [N], [N m] of the channels at action 1."""
        return tuple(getattr(p, f"thrust_{c}") for c in self.channels)


def _over_ground(state: State, current: CurrentVelocity, ns: Namespace) -> State:
    x, y, psi, u, v, r = state
    V_u, V_v = to_body(*current, ns.cos(psi), ns.sin(psi))
    return x, y, psi, u + V_u, v + V_v, r


def _terms(
    errors: State,
    measured: State,
    reference: Sequence[Number],
    limits: Sequence[Number],
    action: Sequence[Number],
    dt: Number,
    ns: Namespace,
) -> tuple[Number, ...]:
    x_e, y_e, psi_e, u_e, v_e, r_e = errors
    cos_psi, sin_psi = ns.cos(measured[2]), ns.sin(measured[2])
    e_x, e_y = to_body(x_e, y_e, cos_psi, sin_psi)
    return e_x, e_y, psi_e, u_e, v_e, r_e, *reference[3:], cos_psi, sin_psi, *limits, *action, dt


def _displaced(ahead: Sequence[Number], o: Observation, _: Namespace) -> tuple[Number, ...]:
    x, y = ahead
    return to_body(x, y, o.cos_psi, o.sin_psi)


PLANE = Model(
    name="plane",
    Plant=Plant,
    Sample=Sample,
    Reference=ReferencePoint,
    Parameters=Parameters,
    Observation=Observation,
    channels=("u", "r"),
    driven=("X", "N"),
    position=("x", "y"),
    velocity=("u", "v"),
    current=("V_x", "V_y"),
    load=("X", "Y", "N"),
    advance=rk4_step,
    from_outside=from_outside,
    over_ground=_over_ground,
    errors=tracking_errors,
    terms=_terms,
    displaced=_displaced,
)
"""Motion in the horizontal plane."""
