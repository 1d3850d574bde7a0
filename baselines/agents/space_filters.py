"""Kalman filters with scheduled gains in space: those of `baselines.agents.filters` for a rough and for a calm sea.

Heave and -pitch are to the vertical plane what sway and yaw are to the horizontal plane, so one table of gains serves
both. The noise of the depth has a level of its own. The prediction uses the whole model in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from auv_gym.physics.namespaces import Namespace, Number, sum_of_squares, wrap_angle
from auv_gym.task.space import Observation, in_body_frame, in_world
from baselines.agents import filters
from baselines.agents.filters import ACROSS, ALONG, LAGS, POSITION_LEVELS, VELOCITY_LEVELS, estimate_of
from baselines.estimation.sea_model import measurement, transition
from baselines.policy import is_fast
from baselines.space.kalman import SPACE_SEA, SpaceEstimate, measured_motion, reference_motion

_FIELDS: tuple[str, ...] = SpaceEstimate._fields
MEMORY_ENTRIES = tuple(name for name in _FIELDS if name != "lag")
"""The entries of an estimate that are in a filter's memory."""
FILTERS = 2  # number of filters
_REMEMBERED = 8  # measurements in the memory: all but q and r
UPRIGHT = ("z_e", "theta", "w", "q", "F_q", "V_z", "V_z_rate", "Z", "M", "Z_wave", "Z_swing", "M_wave", "M_swing")
"""Entries of the vertical plane, in the order of `filters.ACROSS`."""
_REVERSED = ("theta", "q", "F_q", "M", "M_wave", "M_swing")  # those whose sign differs from that of yaw
_VECTORS = tuple(tuple(name.format(axis) for axis in "xyz") for name in ("{}_e", "V_{}", "V_{}_rate"))
"""Entries that are vectors in the world."""


class MeasuredNoise(NamedTuple):
    """Squared levels of the noise in the units `filters.LEVELS`, before the measurements of this instant."""

    position: Number  # horizontal
    depth: Number  # in the unit of the position
    heading: Number  # and of the pitch
    velocity: Number


CONSTANT = 2 + _REMEMBERED + len(MeasuredNoise._fields)
"""Number of rows that count as constants in derivatives, see `filters.CONSTANT`: age, waits, measurements, levels."""
ROWS = CONSTANT + FILTERS * len(MEMORY_ENTRIES)
"""Number of rows of the filters' memory, all zero at the start of an episode."""


class FilterOutput(NamedTuple):
    """Output of the filters at a control instant."""

    estimates: tuple[Any, ...]  # a `SpaceEstimate` of each filter
    held: Number  # whether there was no new position fix
    levels: MeasuredNoise
    measured: tuple[Number, ...]  # see `baselines.space.kalman.measured_motion`


def filter_step(
    o: Observation, speed: Number, memory: Sequence[Number], ns: Namespace, vehicle: Sequence[Number]
) -> tuple[FilterOutput, tuple[Number, ...]]:
    """Return the output of the filters after one more observation, and their new memory, see `filters.filter_step`.

    Args:
        o: the observation in SI units.
        speed: of the reference [m/s].
        memory: `ROWS` rows from the previous call; zero at the start of an episode.
        ns: the namespace of the numbers.
        vehicle: row of the nominal vehicle, see `SpaceVehicle.all_coefficients`.
    """
    age, waits, last, before = memory[0], memory[1], memory[2 : 2 + _REMEMBERED], memory[2 + _REMEMBERED : CONSTANT]
    dt, size, initial = o.dt, len(MEMORY_ENTRIES), age <= 0.0
    levels = MeasuredNoise(*(ns.clip(level, 0.0, filters.LARGEST_LEVEL**2) for level in before))
    motion, measured = reference_motion(o, vehicle, ns), tuple(measured_motion(o, ns))
    step = filters.reference_step(motion[:3], motion[3:], dt)
    moved = [a - b + c for a, b, c in zip(measured, last, step, strict=False)]
    held = filters.is_held(moved[:2], age)
    command = o.a_u * o.F_u_max, o.a_q * o.F_q_max, o.a_r * o.F_r_max
    rows = (memory[at : at + size] for at in range(CONSTANT, ROWS, size))
    earlier = [estimate_of(row, lag, SpaceEstimate) for row, lag in zip(rows, LAGS, strict=False)]
    predicted = [transition(z, command, step, dt, vehicle, ns, SPACE_SEA) for z in earlier]
    change = [a - b for a, b in zip(*(measurement(z[0], ns, SPACE_SEA) for z in (predicted, earlier)), strict=True)]
    level_rows = _white_levels(change, measured, last, levels, held | (waits > 0.5), age, o, ns)
    estimates: list[Any] = []
    for i, ahead in enumerate(predicted):
        z = _corrected(i, ahead, measured, held, levels, age, speed, o, ns)
        new, scale = (initial, filters.is_diverged(z)), (speed, levels.position)
        settled = filters.settled(i, z, new, measured, (age, dt), estimates, scale, ns, SPACE_SEA)
        estimates.append(SpaceEstimate._make(settled))
    waiting = ns.where(held, 1.0 + 0.0 * dt, 0.0 * dt)
    entries = (getattr(z, name) for z in estimates for name in MEMORY_ENTRIES)
    now = (ns.clip(age + 1.0, 0.0, 1e6), waiting, *measured[:_REMEMBERED])
    return FilterOutput(tuple(estimates), waiting, levels, measured), (*now, *level_rows, *entries)


def _white_levels(
    change: Sequence[Number],
    measured: Sequence[Number],
    last: Sequence[Number],
    levels: MeasuredNoise,
    gap: Any,
    age: Number,
    o: Observation,
    ns: Namespace,
) -> tuple[Number, ...]:
    """Return the squared levels after one more measurement, see `filters.white_levels`.

    Args:
        change: of the measurements in the last period, as the first filter predicts it.
        measured: the measurements.
        last: the ones before.
        levels: before this measurement.
        gap: whether there is no new position fix, or the first one after a gap.
        age: control periods since the start.
        o: the observation.
        ns: the namespace of the numbers.
    """
    x, y, z, theta, psi, *velocity = (a - b - c for a, b, c in zip(measured, last, change, strict=False))
    psi, weight = wrap_angle(psi, ns), filters.level_share(age, o.dt, ns)
    groups = (x, y), (z,), (theta, psi), velocity
    squares = [sum_of_squares(group) / (2 * len(group)) for group in groups]
    position, heading, speed = filters.level_units(_is_fast(o), ns)
    weights = ns.where(gap, 0.0, weight), weight, weight, weight
    return filters.next_levels(levels, squares, (position, position, heading, speed), weights, age, o.dt, ns)


def _is_fast(o: Observation) -> Any:
    return is_fast(o.u_R, o.v_R) | is_fast(o.u_R, o.w_R)


def _corrected(
    i: int,
    z: Any,
    measured: Sequence[Number],
    held: Any,
    levels: MeasuredNoise,
    age: Number,
    speed: Number,
    o: Observation,
    ns: Namespace,
) -> Any:
    """Return the estimate of filter i after the measurements; an old position does not count.

    The table holds gains of level motion. In a pitched vehicle yaw about its own axis is cos(theta) times the heading,
    and the position across the axis has noise of the depth and of the horizontal position.
    """
    x, y, *innovations = (a - b for a, b in zip(measured, measurement(z, ns, SPACE_SEA), strict=True))
    x, y = ns.where(held, 0.0, x), ns.where(held, 0.0, y)
    height, theta, psi, u, v, w, q, r = innovations
    x, y, height = in_body_frame((x, y, height), o)
    c, s = ns.clip(o.cos_theta, 0.1, 1.0), o.sin_theta
    most, share, fast = filters.most_level(age), filters.speed_share(speed), _is_fast(o)
    velocity = filters.weights(levels.velocity, VELOCITY_LEVELS, most, ns)
    across = c * c * levels.depth + s * s * levels.position
    level, steep = (
        filters.basis(filters.weights(squared, POSITION_LEVELS, most, ns), velocity, share)
        for squared in (levels.position, across)
    )
    along = filters.corrections(i, 0, (x, u), level, fast, ns)
    aside = filters.corrections(i, 1, (y, c * wrap_angle(psi, ns), v, r), level, fast, ns)
    up = filters.corrections(i, 1, (height, -theta, w, -q), steep, fast, ns)
    changes: dict[str, Number] = dict(zip((*ALONG, *ACROSS, *UPRIGHT), (*along, *aside, *up), strict=True))
    changes |= {name: -changes[name] for name in _REVERSED} | {"psi": changes["psi"] / c}
    for vector in _VECTORS:
        changes |= zip(vector, in_world([changes[name] for name in vector], o), strict=True)
    return z._replace(**{name: getattr(z, name) + change for name, change in changes.items()})


def estimated_errors(z: Any, output: FilterOutput, o: Observation, ns: Namespace) -> tuple[Sequence[Number], ...]:
    """Return the tracking errors of an estimate: position in the body frame, angles, velocities over ground, rates.

    Each is the measured error plus the difference of estimate and measurement.
    """
    differences = [a - b for a, b in zip(measurement(z, ns, SPACE_SEA), output.measured, strict=True)]
    _, _, _, theta, psi, *motion = differences
    angles = o.theta_e + theta, o.psi_e + o.cos_theta * wrap_angle(psi, ns)
    u, v, w, q, r = (a + b for a, b in zip((o.u_e, o.v_e, o.w_e, o.q_e, o.r_e), motion, strict=True))
    return in_body_frame(z[:3], o), angles, (u, v, w), (q, r)
