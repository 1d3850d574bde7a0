"""The loop of a vehicle and any policy as a map over one control period, linearised about steady motion.

Its state is z = (errors of the vehicle in the frame of the reference, last action, memory of the policy): one control
step of the simulation gives z_(k+1) = F(z_k, psi_k), and the reference's heading psi_k matters to a memory that is kept
in the world. The steady motion is found by letting the loop run. On a straight line the spectral radius of the Jacobian
decides, on a circle that of its product over a revolution (Floquet's multipliers): for that the Jacobian is known at a
few headings, and in between by a Fourier series. What of the memory neither feels the vehicle nor acts on it is left
out. A rate is that of the loop in continuous time, log(radius) / dt.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Circle, Line
from auv_gym.planning.planner import plan
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario, Start
from auv_gym.task.observation import Observation, encode
from auv_gym.task.policy import Policy, preview_of
from auv_gym.task.preview import encode_preview
from auv_gym.task.simulation import SAMPLE, SAMPLE_ROWS, start, step
from baselines.policy import CRUISE_SPEED, Memory, Privileged

_VEHICLE = 8
"""How many entries of z are not memory: six errors and the last action."""
SETTLING = 200.0
"""Seconds that a policy gets to settle."""
_HEADINGS = 12
"""At how many headings of a circle the Jacobian is computed: Fourier's series then has five harmonics."""
_EXACT = 2e-6
"""Difference of an action from the plan's that is none: it has single precision."""
PRIVILEGED = "it looks behind the observation, at the sea itself: a steady motion in still water says nothing about it"
"""Said of a policy that cannot be examined."""
AWAY = 5.0
"""Distance [m] from the reference beyond which there is no steady motion about it."""
WATCHED = 80.0  # [s] how long a nudge is watched, in several parts
_PARTS = 8  # of that time
_FAINT = 1e-6  # [m] below which a nudge is forgotten
REST = 1e-4
"""Distance [m] that a vehicle at rest relative to its reference may move."""
NUDGE = (0.02, 0.02, 0.02, 0.01, 0.01, 0.01)  # [m], [rad], [m/s], [rad/s]: shows what of a memory feels the vehicle
NUDGED = 40  # control steps that this takes
_SHARE = 0.02  # half width of differences as a share of what the nudge moved a memory by
_ROUNDING = 1e-9
"""Relative change of a memory that is none."""
_WIDTH = np.array((1e-3,) * 6 + (1e-4,) * 2)  # half width of the differences of the vehicle's own part, SI units
SLIGHT = 1e-3
"""Entry of the Jacobian, in units of the differences, that is none: actions have single precision."""
_BLOCK = 4096  # most vehicles at once
LEADING = 12  # how many multipliers are iterated together
REVOLUTIONS = 4  # of the iteration


def sampled_scenario(vehicle: Vehicle, speed: float, turn_rate: float) -> Scenario:
    """Return still water with the control period and the limits of the presets for this speed, and the steady path."""
    calm = PRESETS["cruise-calm" if speed > CRUISE_SPEED else "slow-calm"]
    path = Circle(speed, turn_rate) if turn_rate else Line(speed)
    return replace(calm, name="steady", path=path, vehicle=vehicle, start=Start())


@dataclass(frozen=True)
class Steady:
    """What a policy makes of a steady motion."""

    rate: float  # [1/s] at which small errors grow; inf: it leaves the motion, nan: it swings, or the limits forbid it
    offset: float  # [m] mean distance to the reference, inf where it leaves it, nan where the limits forbid it
    swing: float  # [m] how far it keeps moving to and fro; 0 where it comes to rest

    @property
    def held(self) -> bool:
        """Whether the policy stays with the motion: errors fade, or it swings about it."""
        return self.rate < 0 or self.swing > 0


def steady_motion(vehicle: Vehicle, policy: Policy, speed: float, turn_rate: float) -> Steady:
    """Return what a policy makes of steady motion.

    Args:
        vehicle: the vehicle, known exactly.
        policy: with memory or without.
        speed: path speed v_p [m/s], positive.
        turn_rate: omega [rad/s], counter-clockwise; 0 for a straight line.

    Raises:
        ValueError: the policy looks behind the observation, or remembers what is no array of numbers.
    """
    if isinstance(policy, Privileged):
        raise ValueError(PRIVILEGED)
    loop = _Loop.of(vehicle, policy, speed, turn_rate)
    if np.abs(loop.steady_action).max() >= 1:
        return Steady(math.nan, math.nan, 0.0)
    orbit = _pinned(loop)
    if orbit is None:
        orbit = _followed(loop, loop.moved)
    if not math.isfinite(orbit.offset):
        return Steady(math.inf, math.inf, 0.0)
    if orbit.swing > REST:
        return Steady(math.nan, orbit.offset, orbit.swing)
    jacobians = _jacobians(loop, orbit)
    radius = _floquet(loop, orbit, jacobians) if turn_rate else float(np.abs(np.linalg.eigvals(jacobians[0])).max())
    rate = math.log(max(radius, 1e-12)) / loop.dt
    return Steady(_of_a_nudge(loop, orbit, rate) if rate > 0 else rate, orbit.offset, 0.0)


@dataclass(frozen=True)
class _Loop:
    """A policy's loop about one steady motion."""

    policy: Policy
    dt: float  # [s]
    velocities: tuple[float, float, float]  # u_R, v_R [m/s], r_R [rad/s]
    forces: tuple[float, float]  # F_uR [N], F_rR [N m]
    steady_action: Array  # with which the vehicle stays on the reference, shape (2,)
    ahead: Array  # [m] where the reference is n periods later, in its own frame now, shape (P + 1, 2); the first: n = 1
    parameters: Any

    @classmethod
    def of(cls, vehicle: Vehicle, policy: Policy, speed: float, turn_rate: float) -> _Loop:
        """Return the loop, see `growth`."""
        scenario = sampled_scenario(vehicle, speed, turn_rate)
        parameters = scenario.parameters(scenario.draw(np.random.default_rng(0)))
        dt, path = scenario.control_dt, scenario.path
        assert isinstance(path, (Circle, Line))
        _, _, psi, u, v, r, F_u, F_r = plan(path, vehicle, np.array([0.0, 1.0])).table[0].tolist()
        x, y = path.derivatives(dt * np.array((0, 1, *preview_of(policy)), dtype=float))[0]
        ahead = np.array(to_body(x - x[0], y - y[0], math.cos(psi), math.sin(psi))).T[1:]
        steady = np.array((F_u / parameters.F_u_max, F_r / parameters.F_r_max))
        return cls(policy, dt, (u, v, r), (F_u, F_r), steady, ahead, parameters)

    @property
    def on_reference(self) -> Array:
        """The vehicle's part of z without any error, shape (_VEHICLE, 1)."""
        return np.concatenate((np.zeros(6), self.steady_action))[:, None]

    def _sample(self, x: Array, y: Array, psi: Array) -> Any:
        """Return the outside at one time: the reference at a place, nothing else; shape (SAMPLE_ROWS, N)."""
        sample = np.zeros((SAMPLE_ROWS, len(psi)))
        sample[[SAMPLE.x_R, SAMPLE.y_R, SAMPLE.psi_R]] = x, y, psi
        sample[[SAMPLE.u_R, SAMPLE.v_R, SAMPLE.r_R]] = np.array(self.velocities)[:, None]
        sample[[SAMPLE.F_uR, SAMPLE.F_rR]] = np.array(self.forces)[:, None]
        sample[SAMPLE.fix] = 1.0
        return sample

    def observed(self, own: Array, psi: Array) -> tuple[Any, Any]:
        """Return plant and observation, (N, columns), of vehicles with z[:_VEHICLE] = own, at headings (N,)."""
        place = to_world(own[0], own[1], np.cos(psi), np.sin(psi))
        state = (*place, psi + own[2], *(own[3 + i] + self.velocities[i] for i in range(3)))
        nothing = np.zeros(len(psi))
        plant, terms = start(state, self._sample(nothing, nothing, psi), self.parameters, ARRAYS)
        o = Observation._make(terms)._replace(a_u=own[6], a_r=own[7])
        n = len(psi)
        span = self.parameters.parts.span
        rows = encode([np.broadcast_to(term, n) for term in o], ARRAYS, span)
        if len(self.ahead) > 1:
            away = self.ahead[1:].T[:, :, None]
            ways = np.array(to_world(away[0], away[1], np.cos(psi), np.sin(psi))).transpose(1, 0, 2)
            rows = np.vstack((rows, encode_preview(ways, o, ARRAYS, span)))
        return plant._replace(a_u=own[6], a_r=own[7]), rows.T

    def acted(self, seen: Array, memory: Memory | None) -> tuple[Array, Memory]:
        """Return the actions, shape (2, N), and the memory; None begins an episode."""
        first = np.full(len(seen), memory is None)
        action, after = self.policy.predict(seen, memory or None, first)
        arrays = tuple(np.asarray(a) for a in after or ())
        if any(a.dtype.kind not in "fiub" or len(a) != len(seen) for a in arrays):
            raise ValueError("it remembers something else than numbers of each vehicle")
        return np.clip(np.asarray(action, dtype=np.float64).T, -1.0, 1.0), arrays

    def moved(self, own: Array, memory: Memory | None, psi: Array) -> tuple[Array, Memory]:
        """Return vehicle and memory one control period later: F."""
        plant, seen = self.observed(own, psi)
        action, memory = self.acted(seen, memory)
        x, y = to_world(self.ahead[0, 0], self.ahead[0, 1], np.cos(psi), np.sin(psi))
        later = psi + self.dt * self.velocities[2]
        after, _, _ = step(plant, list(action), self._sample(x, y, later), self.parameters, ARRAYS)
        errors = to_body(after.x - x, after.y - y, np.cos(later), np.sin(later))
        rates = (rate - steady for rate, steady in zip((after.u, after.v, after.r), self.velocities, strict=True))
        return np.array((*errors, after.psi - later, *rates, *action)), memory


@dataclass(frozen=True)
class _Orbit:
    """Steady motion at some headings: a column for each of them."""

    psi: Array  # shape (H,)
    own: Array  # shape (_VEHICLE, H)
    memory: Memory  # arrays (H, ...)
    offset: float  # [m] see `Steady`
    swing: float  # [m] see `Steady`


def _headings(loop: _Loop) -> list[int]:
    """Return after how many control steps the headings are looked at: once on a line, all round a circle."""
    if not loop.velocities[2]:
        return [0]
    revolution = 2 * math.pi / abs(loop.velocities[2] * loop.dt)
    return [round(i * revolution / _HEADINGS) for i in range(_HEADINGS)]


def _followed(loop: _Loop, advance: Callable[..., tuple[Array, Memory]]) -> _Orbit:
    """Return the motion that begins on the reference after it had time to settle."""
    steps, turn, looked = math.ceil(SETTLING / loop.dt), loop.dt * loop.velocities[2], _headings(loop)
    own, memory = loop.on_reference, None
    kept: list[tuple[float, Array, Memory]] = []
    places: list[Array] = []
    with np.errstate(all="ignore"):
        for k in range(steps + looked[-1] + 1):
            if k >= 0.9 * steps:
                places.append(own[:2, 0])
            if k - steps in looked:
                kept.append((k * turn, own, memory or ()))
            own, memory = advance(own, memory, np.array([k * turn]))
            if not np.abs(own).max() < AWAY:
                return _Orbit(np.zeros(0), own, (), math.inf, math.inf)
    headings, owns, memories = zip(*kept, strict=True)
    arrays = tuple(np.concatenate(parts) for parts in zip(*memories, strict=True))
    offset, swing = float(np.hypot(*np.mean(places, axis=0))), float(np.ptp(places, axis=0).max())
    return _Orbit(np.array(headings), np.hstack(owns), arrays, offset, swing)


def _pinned(loop: _Loop) -> _Orbit | None:
    """Return the motion on the reference itself, if the policy keeps the vehicle there: it may be unstable."""

    def advance(own: Array, memory: Memory | None, psi: Array) -> tuple[Array, Memory]:
        return own, loop.acted(loop.observed(own, psi)[1], memory)[1]

    orbit = _followed(loop, advance)
    action, _ = loop.acted(loop.observed(orbit.own, orbit.psi)[1], orbit.memory)
    return orbit if np.abs(action - loop.steady_action[:, None]).max() < _EXACT else None


def _flat(memory: Memory, count: int) -> Array:
    """Return memory as rows, shape (entries, N)."""
    rows = [np.asarray(a, dtype=np.float64).reshape(count, -1) for a in memory]
    return np.hstack(rows).T if rows else np.zeros((0, count))


def _shaped(rows: Array, like: Memory) -> Memory:
    """Return rows as memory, arrays of the kinds and shapes of another one's."""
    bounds = np.cumsum([0, *(a[0].size for a in like)]).tolist()
    parts = zip(bounds[:-1], bounds[1:], like, strict=True)
    return tuple(rows[a:b].T.reshape(rows.shape[1], *own.shape[1:]).astype(own.dtype) for a, b, own in parts)


def _widths(loop: _Loop, orbit: _Orbit) -> Array:
    """Return the half widths of the differences of z, shape (n,): 0 where a memory does not feel the vehicle."""
    still, moved = ((orbit.own + d, orbit.memory) for d in (0.0, np.array((*NUDGE, 0.0, 0.0))[:, None]))
    psi, felt = orbit.psi, np.zeros(len(_flat(orbit.memory, len(orbit.psi))))
    for _ in range(NUDGED):
        still, moved = loop.moved(*still, psi), loop.moved(*moved, psi)
        psi = psi + loop.dt * loop.velocities[2]
        difference = _flat(moved[1], len(psi)) - _flat(still[1], len(psi))
        felt = np.maximum(felt, np.abs(difference).max(axis=1, initial=0.0))
    size = np.abs(_flat(orbit.memory, len(orbit.psi))).max(axis=1, initial=0.0)
    return np.concatenate((_WIDTH, np.where(felt > _ROUNDING * size, _SHARE * felt, 0.0)))


def _of_a_nudge(loop: _Loop, orbit: _Orbit, rate: float) -> float:
    """Return the rate [1/s] at which the loop forgets a nudge, if it does; else the rate that is given.

    A filter's covariance has directions that grow and that no motion of the vehicle ever reaches.
    """
    psi, n = orbit.psi[:1], math.ceil(WATCHED / loop.dt / _PARTS)
    still = orbit.own[:, :1], tuple(a[:1] for a in orbit.memory)
    moved, farthest = (still[0] + np.array((*NUDGE, 0.0, 0.0))[:, None], still[1]), np.zeros((_PARTS, n))
    for k in range(_PARTS * n):
        farthest[k // n, k % n] = np.abs(moved[0] - still[0])[:2].max()
        if not farthest[k // n, k % n] < AWAY:
            return rate
        still, moved = loop.moved(*still, psi), loop.moved(*moved, psi)
        psi = psi + loop.dt * loop.velocities[2]
    first, *_, last = (part.max() for part in farthest if part.max() > _FAINT)
    parts = sum(part.max() > _FAINT for part in farthest) - 1
    return math.log(last / first) / (parts * n * loop.dt) if last < 0.5 * first else rate


def _jacobians(loop: _Loop, orbit: _Orbit) -> Array:
    """Return the Jacobians of F at the headings of a motion, in units of the differences, shape (H, n, n)."""
    widths, count = _widths(loop, orbit), len(orbit.psi)
    z = np.vstack((orbit.own, _flat(orbit.memory, count)))
    felt = np.flatnonzero(widths > 0)
    found = np.zeros((count, len(felt), len(felt)))
    for h in range(count):
        shifts = np.zeros((len(z), 2 * len(felt)))
        shifts[felt, np.arange(len(felt))], shifts[felt, len(felt) + np.arange(len(felt))] = widths[felt], -widths[felt]
        later = _applied(loop, z[:, h : h + 1] + shifts, orbit, float(orbit.psi[h]))[felt]
        found[h] = (later[:, : len(felt)] - later[:, len(felt) :]) / (2 * widths[felt, None])
    acting = _acting(np.abs(found).max(axis=0) > SLIGHT)
    return found[:, acting][:, :, acting]


def _applied(loop: _Loop, z: Array, orbit: _Orbit, psi: float) -> Array:
    """Return F of many states, shape (n, N), at one heading."""
    found = []
    for a in range(0, z.shape[1], _BLOCK):
        part = z[:, a : a + _BLOCK]
        count = part.shape[1]
        memory = _shaped(part[_VEHICLE:], orbit.memory) if orbit.memory else None
        own, after = loop.moved(part[:_VEHICLE], memory, np.full(count, psi))
        found.append(np.vstack((own, _flat(after, count))))
    return np.hstack(found)


def _acting(influences: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which entries act on the vehicle, at once or by way of others; [i, j]: whether j acts on i."""
    reached = np.zeros(len(influences), dtype=bool)
    reached[:6] = True
    while True:
        more = reached | influences[reached].any(axis=0)
        if (more == reached).all():
            return reached
        reached = more


def _floquet(loop: _Loop, orbit: _Orbit, jacobians: Array) -> float:
    """Return the spectral radius of a control period, the mean over a revolution of a circle."""
    turn = loop.dt * loop.velocities[2]
    steps = round(2 * math.pi / abs(turn))
    modes = np.arange(-(_HEADINGS // 2) + 1, _HEADINGS // 2)
    waves = np.exp(1j * np.outer(orbit.psi, modes))
    coefficients = np.linalg.lstsq(waves, jacobians.reshape(len(jacobians), -1).astype(complex), rcond=None)[0]
    n = jacobians.shape[1]
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((n, min(n, LEADING))))[0]
    small, first = np.eye(basis.shape[1]), basis
    for _ in range(REVOLUTIONS):
        small, first = np.eye(basis.shape[1]), basis
        for k in range(steps):
            J = (np.exp(1j * modes * (orbit.psi[0] + k * turn)) @ coefficients).real.reshape(n, n)
            basis, R = np.linalg.qr(J @ basis)
            with np.errstate(all="ignore"):
                small = R @ small
    if not np.isfinite(small).all():
        return math.inf
    multipliers = np.linalg.eigvals((first.T @ basis) @ small)
    return float(np.abs(multipliers).max() ** (1 / steps))
