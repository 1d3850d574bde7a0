"""What all controllers share: speeds, regimes, actions, and how a law with memory becomes a policy."""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.observation import SCALES, SIZE, Observation, action_of, decode_observation, decoded_terms
from auv_gym.task.policy import LARGEST, last_commands, measured, preview_of, usable
from auv_gym.task.preview import columns_behind

Memory: TypeAlias = tuple[NDArray[Any], ...]
"""What a controller remembers: arrays whose leading axis counts the N vehicles it steers."""

Starts: TypeAlias = NDArray[np.bool_] | None
"""Where episodes begin, shape (N,); None: where nothing is remembered."""

U_R = Observation._fields.index("u_R")  # where u_R stands in a list of terms, faster to make than an `Observation`
V_R = Observation._fields.index("v_R")  # where v_R stands in a list of terms
A_U = Observation._fields.index("a_u")
"""Column of an observation with the last surge command; that of the yaw command is the next one."""
CRUISE_SPEED = 0.4
"""Reference speed [m/s] above which controllers use their gains for cruise."""
ALL_SPEEDS = (0.0, math.inf)
"""Reference speeds [m/s] of a policy that is made for every one."""
SPEED_FLOOR = 0.02
"""Floor [m/s] under a reference speed that something is divided by."""


def squared_speed(u_R: Number, v_R: Number, ns: Namespace) -> Number:
    """Return the square [m^2/s^2] of `reference_speed`."""
    return ns.clip(u_R * u_R + v_R * v_R, SPEED_FLOOR * SPEED_FLOOR, math.inf)


def reference_speed(u_R: Number, v_R: Number, ns: Namespace) -> Number:
    """Return the speed [m/s] of a reference with velocities u_R, v_R, at least `SPEED_FLOOR`."""
    return ns.sqrt(squared_speed(u_R, v_R, ns))


def is_fast(u_R: Number, v_R: Number) -> Any:
    """Return whether a reference with velocities u_R, v_R [m/s] is faster than `CRUISE_SPEED`, for each vehicle."""
    return u_R * u_R + v_R * v_R > CRUISE_SPEED * CRUISE_SPEED


def first_order(dt: Number, time: Number) -> Any:
    """Return the share of the way that a first-order response of a time constant [s] makes in dt [s], for arrays."""
    return -np.expm1(-dt / time)


class Controller(Protocol):
    """A control law with memory, for N vehicles at once."""

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in at the next control instant.

        Args:
            o: the observation in SI units, fields of shape (N,).
            memory: as `start` or the last call returned it; it must not be changed in place.
            extra: what the observation holds behind its terms, shape (N, columns).
        """


@runtime_checkable
class Privileged(Protocol):
    """A policy that looks behind the observation, as no competitor may; whoever runs it lets it."""

    def prepare(self, scenario: Scenario, episodes: Sequence[Episode]) -> None:
        """Learn, before the reset, which N episodes are to run side by side."""

    def observe(self, env: Any) -> None:
        """Look at the vector environment before each `predict`: `state`, `force`, `current`, `time`."""


class Batched(ABC):
    """A policy, with Stable-Baselines3's `predict`, that acts on batches: one observation is a batch of one.

    One bad number costs one decision. For an observation that is not `usable` the last command, which it holds, is
    repeated, and the memory stays. A memory that gives no finite command for a usable observation begins again.

    Attributes:
        preview: control periods ahead at which it wants to know where the reference is.
        speeds: reference speeds [m/s], least and largest, that it was made for; `predict` warns once of others.
        remembers: whether it has a memory of its own: `predict` warns where that is dropped, and checks that it is
            finite.
        repeated: how many commands were repeated since the policy was made.
    """

    preview: tuple[int, ...] = ()
    speeds: tuple[float, float] = ALL_SPEEDS
    remembers = False
    repeated = 0

    @abstractmethod
    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions (N, 2) for observations (N, n), and the memory; for the other arguments see `predict`."""

    def predict(
        self,
        observation: NDArray[Any],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the action (2,) or actions (N, 2) and the memory, its arrays with leading axis N (1 for one).

        Memory begins again where `state` is None or `episode_start`, shape (N,), is True.

        Args:
            observation: one (n,), or a batch (N, n): the terms, the preview, and perhaps further columns.
            state: the memory that the last call returned.
            episode_start: True where an episode begins.
            deterministic: False for a draw from what a stochastic policy might do.

        Raises:
            ValueError: the observation has the wrong shape or too short a preview, or `state` is of another number of
                vehicles.
        """
        rows = observation[None] if observation.ndim == 1 else observation
        if rows.ndim != 2 or rows.shape[1] < SIZE + 2 * len(self.preview):
            decoded_terms(observation)  # both say what is wrong
            columns_behind(rows, self.preview)
        if state and isinstance(state[-1], _Waiting):
            episode_start = state[-1] if episode_start is None else state[-1] | episode_start
            state = state[:-1]
        if not measured(rows):
            action, memory = self._decided(rows, state, episode_start, deterministic)
            return (action[0] if observation.ndim == 1 else action), memory
        if state is None:
            if self.remembers:
                warn_of_lost_memory(rows, episode_start)
            if self.speeds != ALL_SPEEDS:
                self._warn_of_speed(rows)
        action, memory = self.actions(rows, state, episode_start, deterministic)
        if self.remembers and not self.sound(action, memory):
            action, memory = self._decided(rows, state, episode_start, deterministic)
        return (action[0] if observation.ndim == 1 else action), memory

    def sound(self, action: NDArray[Any], memory: Memory | None) -> bool:
        """Return whether what `actions` has returned is finite, as far as it must be looked at."""
        del memory  # where one that is not finite gives an action that is not
        return is_finite(action)

    def _decided(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return what `predict` does, vehicle by vehicle, where a number is none."""
        n, begins = len(rows), state is None or (False if episode_start is None else episode_start)
        starts, good = np.broadcast_to(np.array(begins, dtype=bool), n), usable(rows)
        action, done, memory = last_commands(rows), np.zeros(n, dtype=bool), state
        if good.any():
            # What is decided for the others is not used; they stay in the batch, whose size may change last digits.
            whole = np.where(np.abs(rows) <= LARGEST, rows, rows[good.argmax()])
            found, after = self.actions(whole, state, starts, deterministic)
            done = good
            if self.remembers:
                finite = _finite_rows(found, after or ())
                if not finite[good].all():
                    found, after = self.actions(whole, state, starts | ~finite, deterministic)
                    finite = _finite_rows(found, after or ())
                done = good & finite
            action[done] = found[done]
            if state is None or after is None:
                memory = after
            else:
                memory = tuple(np.where(along(done, a), a, b) for a, b in zip(after, state, strict=True))
        self.repeated += n - int(np.count_nonzero(done))
        waiting = starts & ~done
        if waiting.all():
            return action, None
        return action, memory and ((*memory, waiting.view(_Waiting)) if waiting.any() else memory)

    def _warn_of_speed(self, rows: NDArray[Any]) -> None:
        """Warn once where a reference's speed is none of `speeds`."""
        speed, (low, high) = np.hypot(rows[:, U_R] * SCALES[U_R], rows[:, V_R] * SCALES[V_R]), self.speeds
        if ((speed < low) | (speed > high)).any():
            self.speeds = ALL_SPEEDS
            warnings.warn(
                f"this policy was trained at reference speeds of {low:.3g} to {high:.3g} m/s, and the episode begins "
                f"at {speed.min():.2g} to {speed.max():.2g} m/s: choose the agent of that regime",
                stacklevel=3,
            )


class _Waiting(np.ndarray[Any, Any]):
    """Which vehicles' episodes have begun without a usable observation: the last array of a memory, if there are any.

    With their next observation they begin.
    """


def is_finite(array: NDArray[Any]) -> bool:
    """Return whether an array holds finite numbers alone, none of them beyond 1e150; it costs a microsecond."""
    entries = array.ravel("K")
    return math.isfinite(entries.dot(entries))


def _finite_rows(action: NDArray[Any], memory: Memory) -> NDArray[np.bool_]:
    """Return for which vehicles action and memory are finite, shape (N,)."""
    finite = np.asarray(np.isfinite(action).all(axis=1))
    for array in memory:
        finite &= np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
    return finite


class Remembering(Batched):
    """A controller with memory as a policy."""

    remembers = True

    def __init__(self, controller: Controller) -> None:
        """Wrap a controller; it stays reachable as `controller`, what it wants to see ahead as `preview`."""
        self.controller = controller
        self.preview = preview_of(controller)

    def sound(self, action: NDArray[Any], memory: Memory | None) -> bool:
        """Return whether action and memory are finite: a controller may act without what it believes."""
        return is_finite(action) and all(map(is_finite, memory or ()))

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory, see `Batched`."""
        del deterministic
        o, state = decode_observation(rows), renewed(state, self.controller.start(len(rows)), episode_start)
        F_u, F_r, state = self.controller.forces(o, state, rows[:, SIZE:])
        return np.stack(action_of((F_u, F_r), o, ARRAYS), axis=1).astype(np.float32), state


class BySpeed:
    """Two controllers in one: at each instant the first steers the slow vehicles and the second the fast ones.

    Both have the same kind of memory, and each goes on with what the other has left in it; both need the same preview.
    """

    def __init__(self, slow: Controller, cruise: Controller) -> None:
        """Join two controllers; where the reference is faster than `CRUISE_SPEED`, the second one acts."""
        self.slow, self.cruise = slow, cruise
        self.preview = preview_of(slow)

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return self.slow.start(n)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in next."""
        fast = is_fast(o.u_R, o.v_R)
        if fast.all():
            return self.cruise.forces(o, memory, extra)
        F_u, F_r, after = self.slow.forces(o, memory, extra)
        if not fast.any():
            return F_u, F_r, after
        C_u, C_r, cruise_after = self.cruise.forces(o, memory, extra)
        chosen = tuple(np.where(along(fast, a), b, a) for a, b in zip(after, cruise_after, strict=True))
        return np.where(fast, C_u, F_u), np.where(fast, C_r, F_r), chosen


def renewed(state: Memory | None, held_out: Memory, episode_start: NDArray[np.bool_] | None) -> Memory:
    """Return the memory of N vehicles, begun anew where `state` is None or `episode_start` is True.

    Args:
        state: as the last control instant left it.
        held_out: that of episodes which begin, arrays of the same shapes.
        episode_start: shape (N,), or one for all.

    Raises:
        ValueError: `state` is of another number of vehicles or arrays.
    """
    if state is None:
        return held_out
    if len(state) != len(held_out) or any(len(a) != len(b) for a, b in zip(state, held_out, strict=True)):
        raise ValueError(f"state is of {len(state[0])} vehicles, the observation of {len(held_out[0])}")
    if episode_start is None or not np.any(episode_start):
        return state
    begins = np.broadcast_to(episode_start, len(held_out[0]))
    return tuple(np.where(along(begins, a), b, a) for a, b in zip(state, held_out, strict=True))


def warn_of_lost_memory(rows: NDArray[Any], episode_start: NDArray[np.bool_] | None) -> None:
    """Warn where a policy that remembers is called without memory in the middle of an episode.

    An episode begins with a last action of zero; who has acted before and hands in nothing has dropped the memory.

    Args:
        rows: observations, shape (N, n).
        episode_start: shape (N,), True where an episode begins; None: not known.
    """
    acted = rows[:, A_U : A_U + 2].any(axis=1)
    if episode_start is not None:
        acted &= ~np.broadcast_to(episode_start, len(rows))
    if acted.any():
        warnings.warn(
            "this policy remembers, and its memory was dropped in the middle of an episode: hand the second value that "
            "predict returns to the next call, action, memory = policy.predict(observation, memory), and None, or "
            "episode_start, where an episode begins",
            stacklevel=3,
        )


def along(mask: NDArray[np.bool_], array: NDArray[Any]) -> NDArray[np.bool_]:
    """Return a mask of vehicles, shape (N,), so that it broadcasts along the leading axis of an array."""
    return mask.reshape(mask.shape + (1,) * (array.ndim - 1))
