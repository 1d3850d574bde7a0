"""Check of measurements in front of a policy: frozen, missing and jumping ones are replaced by those of a model.

The model is the filter for a rough sea of `baselines.agents.filters`, which takes the replaced measurements as well. A
measurement is replaced if it repeats the previous one exactly although its noise usually changes it, or if it jumps and
then differs from the prediction by much more than is usual. After some time a difference is taken as real, and the
model starts again. A measurement that drifts away from the model is not replaced.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Array, Namespace, Number, wrap_angle
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, Vehicle, with_names
from auv_gym.scenarios.vehicles import VehicleModel, as_vehicle
from auv_gym.task.observation import SIZE, Observation, decode, encode
from auv_gym.task.policy import Policy, preview_of
from baselines.agents.filters import LAGS, MEMORY_ENTRIES, ROWS, SHARED, estimate_of, filter_step, reference_step
from baselines.estimation.sea_model import measurement, transition
from baselines.estimation.water_frame import reference_motion
from baselines.policy import Batched, Memory, Starts, reference_speed, renewed

_Symbols = Sequence[Symbol]
_WIDEST = 2**31  # span of encoded observations, so that nothing is clipped again


class Group(NamedTuple):
    """Measurements that come from one sensor."""

    rows: tuple[int, ...]  # in (x_e, y_e, psi, u, v, r)
    noise: float  # [SI units] mean second difference from which the sensor counts as noisy
    floor: float  # [SI units] least difference to the prediction that is not usual
    patience: float  # [s] after which a difference is taken as real


GROUPS = (
    Group((0, 1), 2e-3, 0.5, 5.0),
    Group((2,), 5e-4, 0.25, 30.0),
    Group((3, 4), 5e-4, 0.25, 30.0),
    Group((5,), 2e-4, 0.12, 30.0),
)
"""Position, heading, velocities and yaw rate."""
USUAL = 6.0  # largest difference in multiples of its moving average
JUMP = 0.6  # least change of a measurement in one period, over `Group.floor`, with which a difference begins
MEMORY = 5.0  # [s] averaging time of differences
SETTLED = 50.0  # control periods after the start in which only frozen measurements are replaced
RATE_GAIN = 0.08
"""Gain of a rate whose measurement is replaced, for the innovation of its integral over the control period."""
_SAME = 2e-7  # [SI units] difference of equal measurements, from the rounding of observations


class CheckMemory(NamedTuple):
    """Memory of the check: a row, or a tuple of rows with one for each group or measurement; zero at the start."""

    age: Number  # number of control periods, up to `SETTLED`
    filter: tuple[Number, ...]  # of `filters.filter_step`
    last: tuple[Number, ...]  # last measurements, before they are replaced
    change: tuple[Number, ...]  # their last changes
    rough: tuple[Number, ...]  # moving average of the second differences of each group
    usual: tuple[Number, ...]  # moving average of the differences to the prediction
    waits: tuple[Number, ...]  # [s] for how long each group has differed


SIZES = (1, ROWS, 6, 6, len(GROUPS), len(GROUPS), len(GROUPS))
"""Number of rows of each field of a memory."""
CHECK_ROWS = sum(SIZES)  # number of rows of a memory


def _split(rows: Sequence[Number]) -> CheckMemory:
    """Return a memory from its rows."""
    ends = np.cumsum(SIZES).tolist()
    (age,), *parts = (tuple(rows[b - n : b]) for b, n in zip(ends, SIZES, strict=True))
    return CheckMemory(age, *parts)


class _Reading(NamedTuple):
    """The measurements of a control instant, each of (x_e, y_e, psi, u, v, r)."""

    raw: tuple[Number, ...]
    predicted: tuple[Number, ...]
    apart: tuple[Number, ...]  # raw - predicted
    change: tuple[Number, ...]  # of the position, heading and velocities in the last period


class _Verdict(NamedTuple):
    """What the check says of a group of measurements."""

    off: Any  # whether they are replaced
    wait: Number  # new `CheckMemory.waits`
    rough: Number  # new `CheckMemory.rough`
    usual: Number  # new `CheckMemory.usual`


def checked(
    o: Observation, memory: CheckMemory, coefficients: Coefficients, ns: Namespace
) -> tuple[Observation, tuple[Number, ...], CheckMemory]:
    """Return an observation with replaced measurements, whether each group was replaced, and the new memory.

    Args:
        o: the observation in SI units.
        memory: zeros at the start of an episode, or as the last call returned it.
        coefficients: of the nominal vehicle, in units in which it has the mass, length and speed of the paper's.
        ns: the namespace of the numbers.
    """
    reading = _reading(o, memory, coefficients, ns)
    verdicts = [_verdict(i, reading, memory, o.dt, ns) for i in range(len(GROUPS))]
    lasting: Any = o.dt < 0.0
    for group, verdict in zip(GROUPS, verdicts, strict=True):
        lasting = lasting | (verdict.wait > group.patience)
    off = tuple(verdict.off & (lasting ^ True) for verdict in verdicts)
    seen = _replaced(o, reading, off, ns)
    zero = 0.0 * o.dt
    begun = [ns.where(lasting, zero, row) for row in memory.filter]
    _, after = filter_step(seen, reference_speed(o.u_R, o.v_R, ns), begun, ns, coefficients)
    new = CheckMemory(
        ns.where(lasting, zero, ns.clip(memory.age + 1.0, 0.0, SETTLED)),
        _by_integrals(after, reading.apart, off, o, ns),
        reading.raw,
        tuple(ns.where(memory.age <= 0.0, 0.0 * c, c) for c in reading.change),
        tuple(verdict.rough for verdict in verdicts),
        tuple(verdict.usual for verdict in verdicts),
        tuple(ns.where(lasting, zero, verdict.wait) for verdict in verdicts),
    )
    return seen, tuple(ns.where(x, 1.0, 0.0) for x in off), new


def _reading(o: Observation, memory: CheckMemory, coefficients: Coefficients, ns: Namespace) -> _Reading:
    step = reference_step(reference_motion(o, coefficients, ns), o.dt)
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    raw = x_e, y_e, ns.arctan2(o.sin_psi, o.cos_psi), o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
    estimate = estimate_of(memory.filter[SHARED : SHARED + len(MEMORY_ENTRIES)], LAGS[0])
    command = o.a_u * o.F_u_max, o.a_r * o.F_r_max
    predicted = measurement(transition(estimate, command, step, o.dt, coefficients, ns), ns)
    x, y, *rest = _differences(raw, memory.last, ns)
    return _Reading(raw, predicted, _differences(raw, predicted, ns), (x + step[0], y + step[1], *rest))


def _differences(a: Sequence[Number], b: Sequence[Number], ns: Namespace) -> tuple[Number, ...]:
    """Return the differences of two sets of measurements; that of the headings is wrapped."""
    x, y, psi, *velocities = (one - other for one, other in zip(a, b, strict=True))
    return x, y, wrap_angle(psi, ns), *velocities


def _verdict(i: int, reading: _Reading, memory: CheckMemory, dt: Number, ns: Namespace) -> _Verdict:
    group, rough, usual = GROUPS[i], memory.rough[i], memory.usual[i]
    size = _norm([reading.apart[k] for k in group.rows], ns)
    second = _norm([reading.change[k] - memory.change[k] for k in group.rows], ns)
    same: Any = memory.age > 2.0
    for change in (reading.change, memory.change):  # twice, since a smooth measurement is the same at an extremum
        same = same & (_norm([change[k] for k in group.rows], ns) < _SAME)
    frozen = same & (rough > group.noise)
    jumped = (_norm([reading.change[k] for k in group.rows], ns) > JUMP * group.floor) | (memory.waits[i] > 0.0)
    far = (memory.age >= SETTLED) & (size > group.floor + USUAL * usual) & jumped
    off, share = frozen | far, ns.clip(dt / MEMORY, 0.0, 1.0)
    unchanged = off | (memory.age <= 0.0)
    usual = ns.where(unchanged, usual, usual + share * (size - usual))
    return _Verdict(
        off,
        ns.where(far, memory.waits[i] + dt, 0.0 * dt),
        ns.where(unchanged, rough, rough + share * (second - rough)),
        ns.where(frozen, usual + dt * group.floor, usual),  # the prediction drifts
    )


def _replaced(o: Observation, reading: _Reading, off: Sequence[Any], ns: Namespace) -> Observation:
    """Return the observation with the predicted measurements of some groups."""
    moved, turned, fast, turning = off
    pose = (moved, moved, turned), reading.predicted[:3], reading.raw[:3]
    x_e, y_e, psi = (ns.where(*sides) for sides in zip(*pose, strict=True))
    c, s = ns.where(turned, ns.cos(psi), o.cos_psi), ns.where(turned, ns.sin(psi), o.sin_psi)
    e_x, e_y = to_body(x_e, y_e, c, s)
    u_e, v_e, r_e = (
        ns.where(x, predicted - reference, e)
        for x, predicted, reference, e in zip(
            (fast, fast, turning), reading.predicted[3:], (o.u_R, o.v_R, o.r_R), (o.u_e, o.v_e, o.r_e), strict=True
        )
    )
    return o._replace(
        e_x=ns.where(moved | turned, e_x, o.e_x),
        e_y=ns.where(moved | turned, e_y, o.e_y),
        psi_e=ns.where(turned, wrap_angle(o.psi_e - reading.apart[2], ns), o.psi_e),
        u_e=u_e, v_e=v_e, r_e=r_e, cos_psi=c, sin_psi=s,
    )  # fmt: skip


def _by_integrals(
    memory: Sequence[Number], apart: Sequence[Number], off: Sequence[Any], o: Observation, ns: Namespace
) -> tuple[Number, ...]:
    """Return the filters' memory with rates corrected by their integrals, where only the rates are replaced.

    The gains of the filters for this are small, since they are designed for measured rates.
    """
    rows, gain = list(memory), RATE_GAIN / o.dt
    position, heading, velocity, yaw_rate = off
    along, across = to_body(apart[0], apart[1], o.cos_psi, o.sin_psi)
    for name, innovation, rate, integral in (
        ("u", along, velocity, position), ("v", across, velocity, position), ("r", apart[2], yaw_rate, heading),
    ):  # fmt: skip
        k = SHARED + MEMORY_ENTRIES.index(name)
        rows[k] = ns.where(rate & (integral ^ True), rows[k] + gain * innovation, rows[k])
    return tuple(rows)


def _norm(components: Sequence[Number], ns: Namespace) -> Any:
    """Return the length of a vector of one or two components."""
    return abs(components[0]) if len(components) == 1 else ns.sqrt(sum(c * c for c in components))


@lru_cache(maxsize=64)
def check_kernel(vehicle: Coefficients) -> Kernel:
    """Return the kernel of `checked` for observations with the terms on the first axis."""

    def equation(observation: _Symbols, memory: _Symbols) -> Mapping[str, _Symbols]:
        o = Observation._make(decode(observation, SYMBOLS))
        repaired, replaced, after = checked(o, _split(memory), vehicle, SYMBOLS)
        flat = [after.age, *(row for part in after[1:] for row in part)]
        return {"repaired": encode(repaired, SYMBOLS, _WIDEST), "replaced": replaced, "after": flat}

    return Kernel.traced(equation, {"observation": SIZE, "memory": CHECK_ROWS}, blocked=True)


class Checked(Batched):
    """A policy with a check of its measurements.

    Its memory is that of the check, shape (N, `CHECK_ROWS`), then that of the policy.

    Args:
        policy: gets the checked observations.
        vehicle: the nominal one in the paper's units. None: the paper's.
    """

    def __init__(self, policy: Policy, vehicle: Vehicle | VehicleModel | None = None) -> None:
        self.policy, self.preview = policy, preview_of(policy)
        known = as_vehicle(vehicle or PAPER_VEHICLE)
        self._kernel = check_kernel(with_names(known.all_coefficients))

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory, see `Batched`."""
        own = renewed(state and state[:1], (np.zeros((len(rows), CHECK_ROWS)),), episode_start)[0]
        found = self._kernel(observation=rows[:, :SIZE].T.astype(np.float64), memory=own.T.copy())
        seen = rows.astype(np.float64)
        replaced = np.asarray(found["replaced"].any(axis=0))
        seen[:, :SIZE] = np.where(replaced[:, None], found["repaired"].T, rows[:, :SIZE])
        _turn(seen, rows, 2 * len(self.preview))
        action, past = self.policy.predict(seen, state[1:] or None if state else None, episode_start, deterministic)
        return action, (found["after"].T.copy(), *(past or ()))


def _turn(seen: Array, rows: NDArray[Any], columns: int) -> None:
    """Rotate the columns of a preview from the measured heading into that of the checked observations."""
    c, s = Observation._fields.index("cos_psi"), Observation._fields.index("sin_psi")
    turn = np.arctan2(rows[:, s], rows[:, c]) - np.arctan2(seen[:, s], seen[:, c])
    turned = turn != 0.0
    angle = turn[turned, None]
    x, y = (seen[turned, first : SIZE + columns : 2] for first in (SIZE, SIZE + 1))
    seen[turned, SIZE : SIZE + columns : 2], seen[turned, SIZE + 1 : SIZE + columns : 2] = to_world(
        x, y, np.cos(angle), np.sin(angle)
    )
