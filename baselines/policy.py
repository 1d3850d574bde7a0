"""Shared parts of all policies: reference speeds, control laws with memory, and the interface for batches."""

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
from auv_gym.task.observation import PLANE_LAYOUT, Layout, Observation
from auv_gym.task.policy import last_commands, measured, preview_of, usable
from auv_gym.task.preview import columns_behind

Memory: TypeAlias = tuple[NDArray[Any], ...]
"""The state of a controller: arrays with one entry for each of N vehicles along their first axis."""

Starts: TypeAlias = NDArray[np.bool_] | None
"""The vehicles whose episodes begin, shape (N,); None: those without memory."""

U_R = Observation._fields.index("u_R")  # index of u_R in a list of terms, which is faster to make than `Observation`
V_R = Observation._fields.index("v_R")  # index of v_R in a list of terms
CRUISE_SPEED = 0.4
"""Reference speed [m/s] above which controllers use their gains for cruise."""
ALL_SPEEDS = (0.0, math.inf)
"""Range of reference speeds [m/s] of a policy for all speeds."""
SPEED_FLOOR = 0.02
"""Smallest reference speed [m/s] in a denominator."""


def squared_speed(u_R: Number, v_R: Number, ns: Namespace) -> Number:
    """Return the square [m^2/s^2] of `reference_speed`."""
    return ns.clip(u_R * u_R + v_R * v_R, SPEED_FLOOR * SPEED_FLOOR, math.inf)


def reference_speed(u_R: Number, v_R: Number, ns: Namespace) -> Number:
    """Return the speed [m/s] of a reference with velocities u_R, v_R [m/s], at least `SPEED_FLOOR`."""
    return ns.sqrt(squared_speed(u_R, v_R, ns))


def is_fast(u_R: Number, v_R: Number) -> Any:
    """Return whether a reference with velocities u_R, v_R [m/s] is faster than `CRUISE_SPEED`, for each vehicle."""
    return u_R * u_R + v_R * v_R > CRUISE_SPEED * CRUISE_SPEED


def first_order(dt: Number, time: Number) -> Any:
    """Return 1 - exp(-dt / time): the step response after dt [s] of a first-order system of this time constant [s]."""
    return -np.expm1(-dt / time)


class Controller(Protocol):
    """A control law with memory, for N vehicles at once.

    Its attribute `layout`, if there is one, is that of the observations in space, and it returns a force for each
    channel.
    """

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""

    def forces(self, o: Any, memory: Memory, extra: Array) -> tuple[Any, ...]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory for the next control instant.

        Args:
            o: the observation in SI units, fields of shape (N,).
            memory: the memory from `start` or from the last call; it must not be changed in place.
            extra: the columns of the observation after its terms, shape (N, columns).
        """


@runtime_checkable
class Privileged(Protocol):
    """A reference policy that has access to the true state and to the disturbances; entries may not have it."""

    def prepare(self, scenario: Scenario, episodes: Sequence[Episode]) -> None:
        """Take the N episodes that will run in parallel; called before the reset."""

    def observe(self, env: Any) -> None:
        """Read `state`, `force`, `current` and `time` of the vector environment; called before each `predict`."""


class Batched(ABC):
    """A policy that acts on batches, with the `predict` of Stable-Baselines3; one observation is a batch of one.

    For an observation that is not `usable`, the policy repeats the last command, which is part of the observation, and
    keeps its memory. If the memory gives no finite command for a usable observation, the memory is reset.

    Attributes:
        preview: numbers of control periods ahead at which the policy needs the position of the reference.
        speeds: smallest and largest reference speed [m/s] that the policy was made for; `predict` warns once of others.
        remembers: whether the policy has a memory. If so, `predict` warns if the memory is dropped, and checks that it
            is finite.
        repeated: number of repeated commands since the policy was made.
    """

    layout: Layout = PLANE_LAYOUT  # of the observations
    preview: tuple[int, ...] = ()
    speeds: tuple[float, float] = ALL_SPEEDS
    remembers = False
    repeated = 0

    @abstractmethod
    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions (N, 2) for observations (N, n), and the memory; the other arguments are those of `predict`."""

    def predict(
        self,
        observation: NDArray[Any],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the action (2,) or actions (N, 2), and the memory: arrays of first axis N, 1 for one observation.

        The memory is reset if `state` is None, and for the vehicles where `episode_start`, shape (N,), is True.

        Args:
            observation: one (n,), or a batch (N, n): the terms, the preview, and optional further columns.
            state: the memory that the last call returned.
            episode_start: True where an episode begins.
            deterministic: False: a stochastic policy draws its action.

        Raises:
            ValueError: the observation has the wrong shape, its preview is too short, or `state` has another number of
                vehicles.
        """
        rows = observation[None] if observation.ndim == 1 else observation
        layout = self.layout
        if rows.ndim != 2 or rows.shape[1] < layout.size + layout.axes * len(self.preview):
            layout.terms_of(observation)  # one of these two raises the ValueError
            columns_behind(rows, self.preview, layout)
        if state and isinstance(state[-1], _NotStarted):
            episode_start = state[-1] if episode_start is None else state[-1] | episode_start
            state = state[:-1]
        if not measured(rows, layout):
            action, memory = self._actions_by_row(rows, state, episode_start, deterministic)
            return (action[0] if observation.ndim == 1 else action), memory
        if state is None:
            if self.remembers:
                warn_of_dropped_memory(rows, episode_start, layout)
            if self.speeds != ALL_SPEEDS:
                self._warn_of_speed(rows)
        action, memory = self.actions(rows, state, episode_start, deterministic)
        if self.remembers and not self.sound(action, memory):
            action, memory = self._actions_by_row(rows, state, episode_start, deterministic)
        return (action[0] if observation.ndim == 1 else action), memory

    def sound(self, action: NDArray[Any], memory: Memory | None) -> bool:
        """Return whether the actions are finite; with `Remembering` the memory is checked too."""
        del memory  # of a policy whose actions are not finite if its memory is not
        return is_finite(action)

    def _actions_by_row(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory of a batch in which a measurement, an action or a memory is not usable."""
        n, begins = len(rows), state is None or (False if episode_start is None else episode_start)
        starts, good = np.broadcast_to(np.array(begins, dtype=bool), n), usable(rows, self.layout)
        action, done, memory = last_commands(rows, self.layout), np.zeros(n, dtype=bool), state
        if good.any():
            # A usable row replaces the others, since the size of the batch may change last digits.
            whole = np.where(good[:, None], rows, rows[good.argmax()])
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
                seen = done | starts & good
                memory = tuple(np.where(along(seen, a), a, b) for a, b in zip(after, state, strict=True))
        self.repeated += n - int(np.count_nonzero(done))
        not_started = starts & ~good
        if not_started.all():
            return action, None
        return action, memory and ((*memory, not_started.view(_NotStarted)) if not_started.any() else memory)

    def _warn_of_speed(self, rows: NDArray[Any]) -> None:
        """Warn once if the speed of a reference is outside of `speeds`."""
        columns, scales = self.layout.velocity, self.layout.scales
        speed, (low, high) = np.sqrt(sum((rows[:, k] * scales[k]) ** 2 for k in columns)), self.speeds
        if ((speed < low) | (speed > high)).any():
            self.speeds = ALL_SPEEDS
            trained = f"of {low:.3g} to {high:.3g} m/s" if high < math.inf else f"from {low:.3g} m/s on"
            begins = " to ".join(dict.fromkeys(f"{x:.2g}" for x in (speed.min(), speed.max())))
            warnings.warn(
                f"this policy was trained at reference speeds {trained}, and the episode begins at {begins} m/s: "
                "choose the agent for that speed range",
                stacklevel=3,
            )


class _NotStarted(np.ndarray[Any, Any]):
    """Mask (N,) of vehicles that have had no usable observation in their episode; the last array of a memory.

    The memory has no such array if there are no such vehicles. The next usable observation starts their memory.
    """


def is_finite(array: NDArray[Any]) -> bool:
    """Return whether all entries of an array are finite and at most 1e150 in magnitude; it takes a microsecond."""
    entries = array.ravel("K")
    return math.isfinite(entries.dot(entries))


def _finite_rows(action: NDArray[Any], memory: Memory) -> NDArray[np.bool_]:
    """Return the mask (N,) of the vehicles whose action and memory are finite."""
    finite = np.asarray(np.isfinite(action).all(axis=1))
    for array in memory:
        finite &= np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
    return finite


class Remembering(Batched):
    """A policy that runs a controller with memory."""

    remembers = True

    def __init__(self, controller: Controller) -> None:
        """Wrap a controller; `controller` is the controller, `preview` its preview."""
        self.controller = controller
        self.preview = preview_of(controller)
        self.layout = getattr(controller, "layout", PLANE_LAYOUT)

    def sound(self, action: NDArray[Any], memory: Memory | None) -> bool:
        """Return whether action and memory are finite: an estimate in the memory need not affect the action."""
        return is_finite(action) and all(map(is_finite, memory or ()))

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory, see `Batched`."""
        del deterministic
        layout = self.layout
        o = layout.named(layout.terms_of(rows))
        *forces, after = self.controller.forces(
            o, renewed(state, self.controller.start(len(rows)), episode_start), rows[:, layout.size :]
        )
        return np.stack(layout.action_of(forces, o, ARRAYS), axis=1).astype(np.float32), after


class BySpeed:
    """A controller that switches between two controllers by the speed of the reference.

    Both controllers have the same kind of memory, which they share, and the same preview.
    """

    def __init__(self, slow: Controller, cruise: Controller) -> None:
        """Combine two controllers; `cruise` controls the vehicles whose reference is faster than `CRUISE_SPEED`."""
        self.slow, self.cruise = slow, cruise
        self.preview = preview_of(slow)

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return self.slow.start(n)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory for the next control instant."""
        fast = is_fast(o.u_R, o.v_R)
        if fast.all():
            return self.cruise.forces(o, memory, extra)
        F_u, F_r, after = self.slow.forces(o, memory, extra)
        if not fast.any():
            return F_u, F_r, after
        C_u, C_r, cruise_after = self.cruise.forces(o, memory, extra)
        chosen = tuple(np.where(along(fast, a), b, a) for a, b in zip(after, cruise_after, strict=True))
        return np.where(fast, C_u, F_u), np.where(fast, C_r, F_r), chosen


def renewed(state: Memory | None, initial: Memory, episode_start: NDArray[np.bool_] | None) -> Memory:
    """Return the memory of N vehicles, reset if `state` is None, and where `episode_start` is True.

    Args:
        state: the memory of the last control instant.
        initial: the memory at the start of episodes, arrays of the same shapes.
        episode_start: shape (N,), or one value for all.

    Raises:
        ValueError: `state` has another number of vehicles or arrays.
    """
    if state is None:
        return initial
    if len(state) != len(initial) or any(len(a) != len(b) for a, b in zip(state, initial, strict=True)):
        raise ValueError(f"state is of {len(state[0])} vehicles, the observation of {len(initial[0])}")
    if episode_start is None or not np.any(episode_start):
        return state
    begins = np.broadcast_to(episode_start, len(initial[0]))
    return tuple(np.where(along(begins, a), b, a) for a, b in zip(state, initial, strict=True))


def warn_of_dropped_memory(
    rows: NDArray[Any], episode_start: NDArray[np.bool_] | None, layout: Layout = PLANE_LAYOUT
) -> None:
    """Warn if a policy with memory is called without it in the middle of an episode.

    At the beginning of an episode the last action in the observation is zero; later it usually is not.

    Args:
        rows: observations, shape (N, n).
        episode_start: shape (N,), True where an episode begins; None: not known.
        layout: of the observations.
    """
    acted = rows[:, layout.last].any(axis=1)
    if episode_start is not None:
        acted &= ~np.broadcast_to(episode_start, len(rows))
    if acted.any():
        warnings.warn(
            "this policy has a memory, and its memory was dropped in the middle of an episode: pass the second value "
            "that predict returns to the next call, action, memory = policy.predict(observation, memory); where an "
            "episode begins, pass None instead, or episode_start",
            stacklevel=3,
        )


def along(mask: NDArray[np.bool_], array: NDArray[Any]) -> NDArray[np.bool_]:
    """Return a mask of vehicles, shape (N,), reshaped to broadcast along the first axis of an array."""
    return mask.reshape(mask.shape + (1,) * (array.ndim - 1))
