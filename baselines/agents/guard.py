"""A floor under a policy: another one takes over where the energy of the expert's errors says that it goes astray.

It is a Simplex architecture (Sha, "Using simplicity to control complexity", IEEE Software 18 (2001) 20): a capable
policy acts, a simple one stands by, and a monitor that knows nothing of either decides between them. The monitor
watches the function V4 (45) that the expert's backstepping is built on, without dimensions. There is an alarm where it
grows, beyond a multiple of its own mean over the last time, and is large: less counts as large while the yaw command is
at its limit nearly all the time, which is how a vehicle on late actuators begins to spin. The other policy takes over
within a fraction of a second. It hands back after a while, which grows from one alarm to the next.
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
from auv_gym.task.observation import SIZE, Observation, decode_observation
from auv_gym.task.policy import Policy, preview_of
from auv_gym.task.preview import shared_preview
from baselines.agents.residual_policy import ResidualPolicy
from baselines.control.backstepping import GAINS, Backstepping, Gains, backstepping_errors
from baselines.policy import Batched, Memory, Starts, first_order, is_fast, reference_speed, renewed

_CORRECTION = 1
"""Which array of an agent's memory is its last correction, shape (N, 2)."""
MEAN = 0  # column of a guard's memory: the mean energy of the last time
GUARD_SHARE = 1  # column of a guard's memory: which share of the policy's command acts
LEFT = 2  # column of a guard's memory: how long the other policy still has the command [s]
ALARMS = 3  # column of a guard's memory: how many alarms there were
EXHAUSTED = 4  # column of a guard's memory: which share of the last time the yaw command was at its limit
ARRAYS_OF_POLICY = 5  # column of a guard's memory: how many arrays of the memory are the policy's


@dataclass(frozen=True)
class Thresholds:
    """When a guard takes over, and for how long; times in units of the law's own, 1 / (k + k1).

    Raises:
        ValueError: one is no positive number.
    """

    energy: float = 4.0  # that is allowed while the yaw command is at its limit most of the time
    exhausted: float = 0.85  # share of the time that the yaw command spends at its limit then
    memory: float = 2.4  # time over which that share is a mean
    most: float = 64.0  # energy that is allowed else
    growth: float = 2.0  # how many times its mean an energy may be
    horizon: float = 7.0  # time over which that is a mean
    start: float = 4.0  # what the mean begins at, where an episode begins, if the energy is not larger
    take: float = 0.5  # time in which the other policy takes over
    give: float = 4.0  # time in which it gives back
    hold: float = 48.0  # time that it keeps the command after the first alarm
    longer: float = 4.0  # factor on that from one alarm to the next

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check_number(f"guard {name}", value, 1e-3, 1e6)


THRESHOLDS = Thresholds()
"""Those of guards by name; `python -m research guard-thresholds` compares them with others."""
MOST_GROWTH = 6.0  # alarms after which the time that the other policy keeps the command grows no more
HORIZON = 1.0  # [s] in which the reference covers the largest position error that the law then sees
AT_LIMIT = 0.999  # magnitude of a command that counts as being at its limit


def energy(o: Sequence[Array], vehicle: Vehicle) -> tuple[Array, Array]:
    """Return the energy of the law's errors, and the law's rate k + k1 [1/s], for observations in SI units.

    The energy is V4 (45) in units of the law's time T = 1/(k + k1) and of the way U T that the reference covers in it:
    ((e/(U T))^2 + (z_u/U)^2 + (z_v/U)^2 + psi_e^2 + (z_r T)^2) / 2. Where the vehicle is a length U T from its
    reference and else as it should be, it is 3/2.

    Args:
        o: the terms, arrays of shape (N,).
        vehicle: the known one.
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
    """Return what a guard hands over to: the expert's law with a bound on the position error that it sees.

    Far from its reference the printed law asks for more than actuators give, and turns the vehicle round and round.
    """
    return Backstepping(vehicle=PAPER_VEHICLE if vehicle is None else as_vehicle(vehicle), horizon=HORIZON)


class Guarded(Batched):
    """A policy with a guard.

    Its memory: the guard's own, shape (N, 6); behind it the policy's, and that of the policy that it hands over to.
    With no alarm the commands are the policy's bit for bit, and once the other one has taken over they are that one's.

    Args:
        policy: what acts where nothing is wrong.
        fallback: what takes over. It runs all the time, so that its memory is up to date.
        vehicle: the known one; an object, a name or a dict. None: the paper's.
        thresholds: when, and for how long.
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
        own = renewed(state and state[:1], (np.zeros((len(rows), 6)),), episode_start)[0]
        pasts = (state[1:split] or None, state[split:] or None) if state else (None, None)
        seen = (np.hstack((rows[:, :SIZE], extra[:, columns])) for columns in (self._seen, self._seen_by_fallback))
        (action, past), (other, its) = (
            policy.predict(row, before, episode_start, deterministic)
            for policy, row, before in zip((self.policy, self.fallback), seen, pasts, strict=True)
        )
        begins = (own[:, GUARD_SHARE] == 0) & (own[:, LEFT] == 0) & (own[:, MEAN] == 0)
        own = self._watched(o, own, begins)
        share = own[:, GUARD_SHARE, None]
        if isinstance(self.policy, ResidualPolicy) and past is not None:
            # A network is told which correction has acted.
            past = (*past[:_CORRECTION], past[_CORRECTION] * share, *past[_CORRECTION + 1 :])
        own[:, ARRAYS_OF_POLICY] = len(past or ())
        mixed = (other + share * (action - other)).astype(np.float32)
        command = np.where(share >= 1.0, action, np.where(share <= 0.0, other, mixed))
        return command, (own, *(past or ()), *(its or ()))

    def _watched(self, o: Observation, before: Array, begins: NDArray[np.bool_]) -> Array:
        """Return the guard's memory after a look at the observation."""
        t = self.thresholds
        now, rate = energy(o, self.vehicle)
        step = o.dt * rate
        mean, share, left, alarms, exhausted = (before[:, i] for i in range(5))
        still = np.maximum(left - o.dt, 0.0)
        held_out = begins | ((still == 0.0) & (left > 0.0))  # what begins, and what is handed back
        mean = np.where(held_out, np.maximum(now, t.start), mean + first_order(step, t.horizon) * (now - mean))
        exhausted = exhausted + first_order(step, t.memory) * ((np.abs(o.a_r) >= AT_LIMIT) - exhausted)
        exhausted = np.where(held_out, 0.0, exhausted)
        over = (now > t.energy) & (exhausted > t.exhausted) | (now > t.most)
        alarm = (still == 0.0) & over & (now > t.growth * mean)
        left = np.where(alarm, t.hold / rate * t.longer ** np.minimum(alarms, MOST_GROWTH), still)
        share = np.where(begins, 1.0, share) + np.where(left > 0.0, -step / t.take, step / t.give)
        rows = mean, np.clip(share, 0.0, 1.0), left, alarms + alarm, exhausted, before[:, ARRAYS_OF_POLICY]
        return np.stack(rows, axis=1)
