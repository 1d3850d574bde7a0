"""Guard of a policy: a fallback policy takes over if the energy of the tracking errors indicates divergence.

It is a Simplex architecture (Sha, "Using simplicity to control complexity", IEEE Software 18 (2001) 20): a complex
policy acts, a simple policy is the fallback, and a monitor that is independent of both switches between them. The
monitor computes the function V4 (45) of the paper in dimensionless form. It raises an alarm if V4 exceeds both a
multiple of its moving average and a threshold. The threshold is lower while the yaw command is at its limit most of the
time, because this is how a vehicle with slow actuators begins to spin. The fallback takes over within a fraction of a
second. It returns the control to the policy after a hold time, which increases with every alarm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.vehicles import as_vehicle
from auv_gym.task.decoding import decode_observation
from auv_gym.task.observation import SIZE, Observation
from auv_gym.task.policy import Policy, preview_of
from auv_gym.task.preview import shared_preview
from baselines.agents.residual_policy import ResidualPolicy
from baselines.control.backstepping import GAINS, Backstepping, Gains, backstepping_errors
from baselines.policy import Batched, Memory, Starts, first_order, is_fast, reference_speed, renewed

_CORRECTION = 1
"""Index of the last correction, shape (N, 2), in an agent's memory."""
# Columns of a guard's memory:
MEAN = 0  # moving average of the energy
GUARD_SHARE = 1  # weight of the policy's command
LEFT = 2  # [s] remaining time of the fallback
ALARMS = 3  # number of alarms
EXHAUSTED = 4  # moving average of the share of time with the yaw command at its limit
ARRAYS_OF_POLICY = 5  # number of arrays of the policy's memory


@dataclass(frozen=True)
class Thresholds:
    """Thresholds and times of a guard; times are in units of the law's time constant 1 / (k + k1).

    Raises:
        ValueError: a value is not a positive number.
    """

    energy: float = 4.0  # largest energy while the yaw command is at its limit most of the time
    exhausted: float = 0.85  # share of time with the yaw command at its limit from which `energy` applies
    memory: float = 2.4  # averaging time of that share
    most: float = 64.0  # largest energy otherwise
    growth: float = 2.0  # largest energy over its moving average
    horizon: float = 7.0  # averaging time of the energy
    start: float = 4.0  # least initial value of the moving average
    take: float = 0.5  # time in which the fallback takes over
    give: float = 4.0  # time in which the policy takes over again
    hold: float = 48.0  # hold time of the fallback after the first alarm
    longer: float = 4.0  # factor on the hold time per alarm

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check_number(f"guard {name}", value, 1e-3, 1e6)


THRESHOLDS = Thresholds()
"""Default of guards, chosen on episodes that no suite has."""
MOST_GROWTH = 6.0  # number of alarms after which the hold time stays constant
HORIZON = 1.0  # [s] bound of the fallback's position error as a travel time of the reference
AT_LIMIT = 0.999  # magnitude from which a command counts as at its limit


def energy(o: Sequence[Array], vehicle: Vehicle) -> tuple[Array, Array]:
    """Return the energy of the law's errors, and the law's rate k + k1 [1/s], for observations in SI units.

    The energy is V4 (45) in units of the law's time constant T = 1/(k + k1) and of the distance U T that the reference
    covers in it: ((e/(U T))^2 + (z_u/U)^2 + (z_v/U)^2 + psi_e^2 + (z_r T)^2) / 2. At a position error of U T and no
    other error it is 3/2.

    Args:
        o: the terms, arrays of shape (N,).
        vehicle: the nominal one.
    """
    fast = is_fast(o[6], o[7])
    slow, cruise = (_energy(o, vehicle, GAINS[name]) for name in ("paper", "cruise"))
    return np.where(fast, cruise[0], slow[0]), np.where(fast, cruise[1], slow[1])


def _energy(o: Sequence[Array], vehicle: Vehicle, gains: Gains) -> tuple[Array, float]:
    e_x, e_y, psi_e = o[:3]
    z_u, z_v, z_r, _ = backstepping_errors(o, vehicle.m11 / vehicle.m22, gains, ARRAYS)
    rate = gains.k + gains.k1
    per_U = 1.0 / reference_speed(o[6], o[7], ARRAYS)
    position = (rate * per_U) ** 2 * (e_x * e_x + e_y * e_y)
    speeds = per_U**2 * (z_u * z_u + z_v * z_v)
    return 0.5 * (position + speeds + psi_e * psi_e + (z_r / rate) ** 2), rate  # (45)


def bounded_law(vehicle: Vehicle | str | Mapping[str, Any] | None = None) -> Backstepping:
    """Return the default fallback of a guard: the expert's law with a bound on the position error.

    Far from the reference the commands of the law without a bound saturate the actuators, and the vehicle spins.
    """
    return Backstepping(vehicle=PAPER_VEHICLE if vehicle is None else as_vehicle(vehicle), horizon=HORIZON)


class Guarded(Batched):
    """A policy with a guard.

    The memory is that of the guard, shape (N, 6), then that of the policy, then that of the fallback. Without an alarm
    the commands are exactly those of the policy. After the fallback has taken over they are exactly those of the
    fallback.

    Args:
        policy: acts as long as there is no alarm.
        fallback: takes over after an alarm. It runs all the time, so that its memory is up to date.
        vehicle: the nominal one; an object, a name or a dict. None: the paper's.
        thresholds: of the monitor.
    """

    def __init__(
        self,
        policy: Policy,
        fallback: Policy,
        vehicle: Vehicle | str | Mapping[str, Any] | None = None,
        thresholds: Thresholds = THRESHOLDS,
    ) -> None:
        self.policy, self.fallback, self.thresholds = policy, fallback, thresholds
        self.vehicle = PAPER_VEHICLE if vehicle is None else as_vehicle(vehicle)
        self.preview, self._seen, self._seen_by_fallback = shared_preview(preview_of(policy), preview_of(fallback))

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory, see `Batched`."""
        o, extra = decode_observation(rows), rows[:, SIZE:]
        split = 1 + int(state[0][0, ARRAYS_OF_POLICY]) if state else 1
        monitor = renewed(state and state[:1], (np.zeros((len(rows), 6)),), episode_start)[0]
        pasts = (state[1:split] or None, state[split:] or None) if state else (None, None)
        seen = (np.hstack((rows[:, :SIZE], extra[:, columns])) for columns in (self._seen, self._seen_by_fallback))
        (action, past), (other, other_past) = (
            policy.predict(row, before, episode_start, deterministic)
            for policy, row, before in zip((self.policy, self.fallback), seen, pasts, strict=True)
        )
        begins = (monitor[:, GUARD_SHARE] == 0) & (monitor[:, LEFT] == 0) & (monitor[:, MEAN] == 0)
        monitor = self._monitored(o, monitor, begins)
        share = monitor[:, GUARD_SHARE, None]
        if isinstance(self.policy, ResidualPolicy) and past is not None:
            # The last correction is an input of the network: it must be the one that acted.
            past = (*past[:_CORRECTION], past[_CORRECTION] * share, *past[_CORRECTION + 1 :])
        monitor[:, ARRAYS_OF_POLICY] = len(past or ())
        mixed = (other + share * (action - other)).astype(np.float32)
        command = np.where(share >= 1.0, action, np.where(share <= 0.0, other, mixed))
        return command, (monitor, *(past or ()), *(other_past or ()))

    def _monitored(self, o: Observation, before: Array, begins: NDArray[np.bool_]) -> Array:
        """Return the guard's memory after one more observation."""
        t = self.thresholds
        now, rate = energy(o, self.vehicle)
        step = o.dt * rate
        mean, share, left, alarms, exhausted = (before[:, i] for i in range(5))
        remaining = np.maximum(left - o.dt, 0.0)
        reset = begins | ((remaining == 0.0) & (left > 0.0))  # at the start of an episode, and after the hold time
        mean = np.where(reset, np.maximum(now, t.start), mean + first_order(step, t.horizon) * (now - mean))
        exhausted = exhausted + first_order(step, t.memory) * ((np.abs(o.a_r) >= AT_LIMIT) - exhausted)
        exhausted = np.where(reset, 0.0, exhausted)
        over = (now > t.energy) & (exhausted > t.exhausted) | (now > t.most)
        alarm = (remaining == 0.0) & over & (now > t.growth * mean)
        left = np.where(alarm, t.hold / rate * t.longer ** np.minimum(alarms, MOST_GROWTH), remaining)
        share = np.where(begins, 1.0, share) + np.where(left > 0.0, -step / t.take, step / t.give)
        rows = mean, np.clip(share, 0.0, 1.0), left, alarms + alarm, exhausted, before[:, ARRAYS_OF_POLICY]
        return np.stack(rows, axis=1)
