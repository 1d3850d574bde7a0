"""The interface of a policy, control laws, and the command of residual control."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.intervals import is_float
from auv_gym.physics.namespaces import ARRAYS, FLOATS, Namespace, Number
from auv_gym.task.observation import PLANE_LAYOUT, Layout

LARGEST = 1e12
"""Largest magnitude of a valid entry of an observation; those of the largest ships are below 2e11."""
Forces: TypeAlias = Callable[[Sequence[Number], Namespace], tuple[Number, ...]]
"""A function that returns F_u [N], F_r [N m] for the terms of an observation in SI units and a namespace."""


def measured(observation: NDArray[Any], layout: Layout = PLANE_LAYOUT) -> bool:
    """Return True only if observations, (n,) or (N, n), are `usable`, within two microseconds.

    The test is that of the sum of squares, so it can return False for valid entries.
    """
    entries = observation.ravel("K")
    if not entries.dot(entries) <= LARGEST * LARGEST:
        return False
    if observation.ndim == 1:
        return bool(min(map(observation.item, layout.positive)) > 0)
    return bool(observation.T[layout.positive].min(initial=math.inf) > 0)


def usable(rows: NDArray[Any], layout: Layout = PLANE_LAYOUT) -> NDArray[np.bool_]:
    """Return whether each observation, rows (N, n), is valid, shape (N,).

    All entries must be finite and at most `LARGEST`, and limits and control period positive.
    """
    return np.asarray((np.abs(rows) <= LARGEST).all(axis=1) & (rows[:, layout.positive] > 0).all(axis=1))


def last_commands(rows: NDArray[Any], layout: Layout = PLANE_LAYOUT) -> NDArray[np.float32]:
    """Return the previous actions in observations, rows (N, n), shape (N, channels); zero if invalid."""
    last = rows[:, layout.last]
    return np.where(np.abs(last) <= 1.0, last, 0.0).astype(np.float32)


class Policy(Protocol):
    """The interface of `predict` of Stable-Baselines3, for one observation (n,) or a batch (N, n)."""

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the action, and the memory for the next call."""


class Law(ABC):
    """A control law: a policy without memory whose forces are a pure function of the observation's terms.

    The function computes on any namespace, so it can be traced, compiled and differentiated.

    Attributes:
        repeated: number of repeated commands since the law was made, see `predict`.
    """

    layout: ClassVar[Layout] = PLANE_LAYOUT  # of the observations
    repeated = 0

    @abstractmethod
    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, ...]:
        """Return F_u [N], F_r [N m] for an `Observation` in SI units, or its terms in that order."""

    def check(self, terms: Any) -> None:
        """Warn if the law is not suitable for the observed terms, a list or rows."""
        del terms  # most laws are suitable for all

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the action for an observation of shape (18,), or actions (N, 2) for (N, 18), and `state` unchanged.

        The law has no memory; the arguments after the first are not used. Further columns of observations, such as
        those of the residual environment, are ignored. If an observation is not `usable`, the last command is repeated.

        Raises:
            ValueError: the observation has another shape.
        """
        layout = self.layout
        o = layout.terms_of(observation)
        if not measured(terms := observation[..., : layout.size], layout):
            rows = np.atleast_2d(terms)
            action, good = last_commands(rows, layout), usable(rows, layout)
            vars(self)["repeated"] = self.repeated + int(np.count_nonzero(~good))  # a law may be a frozen dataclass
            if good.any():
                o = layout.terms_of(rows[good])
                action[good] = np.stack(layout.action_of(self.forces(o, ARRAYS), o, ARRAYS), axis=1)
            return action.reshape(*observation.shape[:-1], -1), state
        self.check(o)
        if observation.ndim == 1:
            return np.array(layout.action_of(self.forces(o), o, FLOATS), dtype=np.float32), state
        return np.stack(layout.action_of(self.forces(o, ARRAYS), o, ARRAYS), axis=1).astype(np.float32), state


def traceable(policy: Any) -> bool:
    """Return whether the actions of a policy are given by its `forces`: a hashable `Law` with `Law.predict`.

    Equal laws share their compiled code.
    """
    return isinstance(policy, Law) and isinstance(policy, Hashable) and type(policy).predict is Law.predict


def preview_of(policy: Any) -> tuple[int, ...]:
    """Return the preview that a policy requires, its attribute `preview`; empty if it has none."""
    return tuple(getattr(policy, "preview", ()))


def corrected(base: Number, authority: Number, correction: Number, ns: Namespace) -> Number:
    """Return the command of residual control, clip(base + authority * clip(correction)), for surge, yaw or both.

    Args:
        base: the expert's action, in [-1, 1].
        authority: largest correction.
        correction: action of the agent; 1 is the largest correction.
        ns: the namespace of the numbers, whose shapes are broadcast.
    """
    return ns.clip(base + authority * ns.clip(correction, -1.0, 1.0), -1.0, 1.0)


def checked_authority(authority: float | Sequence[float], channels: int = 2) -> tuple[float, ...]:
    """Return the largest correction of each channel, surge and yaw in the plane.

    Raises:
        ValueError: it is neither a number nor one for each channel, or is not in (0, 2].
    """
    given = authority.tolist() if isinstance(authority, (np.ndarray, np.generic)) else authority
    each = tuple(given) if isinstance(given, Sequence) else (given,) * channels
    if len(each) != channels or not all(is_float(a) and 0 < a <= 2 for a in each):
        several = "surge and yaw" if channels == 2 else "surge, pitch and yaw"
        raise ValueError(f"authority is {authority!r}; it must be a number in (0, 2], or one each for {several}")
    return tuple(map(float, each))
