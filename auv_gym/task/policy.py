"""What acts: the interface of a policy, and the rule that turns an expert and a correction into a command."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import ARRAYS, FLOATS, Namespace, Number
from auv_gym.task.observation import F_R_MAX, F_U_MAX, SIZE, Observation, action_of, decoded_terms

LARGEST = 1e12
"""Magnitude beyond which an entry of an observation was not measured: those of the largest ships are below 2e11."""
_A_U = Observation._fields.index("a_u")  # where the last surge command stands in an observation; yaw's is next to it
_POSITIVE = [F_U_MAX, F_R_MAX, Observation._fields.index("dt")]  # the limits and the control period
Forces: TypeAlias = Callable[[Sequence[Number], Namespace], tuple[Number, Number]]
"""F_u [N], F_r [N m] of the terms of an observation in SI units, computed with a namespace."""


def measured(observation: NDArray[Any]) -> bool:
    """Return whether all entries of observations are finite and not beyond `LARGEST`; it costs a microsecond.

    It may return False where only their squares add up to more.
    """
    entries = observation.ravel("K")
    return bool(entries.dot(entries) <= LARGEST * LARGEST)


def usable(rows: NDArray[Any]) -> NDArray[np.bool_]:
    """Return for which observations, rows (N, n), a command can be computed, shape (N,).

    All entries are finite and not beyond `LARGEST`, and limits and control period are positive.
    """
    return np.asarray((np.abs(rows) <= LARGEST).all(axis=1) & (rows[:, _POSITIVE] > 0).all(axis=1))


def last_commands(rows: NDArray[Any]) -> NDArray[np.float32]:
    """Return the actions before observations, rows (N, n), that these hold, shape (N, 2); zero for what is none."""
    last = rows[:, _A_U : _A_U + 2]
    return np.where(np.abs(last) <= 1.0, last, 0.0).astype(np.float32)


class Policy(Protocol):
    """Whatever acts: Stable-Baselines3's `predict`, for one observation (n,) or a batch (N, n)."""

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the action and the memory to hand in at the next call."""


class Law(ABC):
    """A policy without memory whose forces are a pure function of the observation's terms.

    That function runs on the numbers of any namespace, so it can be traced, compiled and differentiated.
    """

    @abstractmethod
    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, Number]:
        """Return F_u [N], F_r [N m] for a `task.Observation` in SI units, or its terms in that order."""

    def check(self, terms: Any) -> None:
        """Look at what is observed, the terms as a list or as rows, and warn if the law is not made for it."""
        del terms  # most laws are made for everything

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the action for an observation of shape (18,), or actions (N, 2) for (N, 18), and `state` untouched.

        The law has no memory; the arguments behind the first are those of every policy. Wider observations, as the
        residual environment's, are fine. Where an observation is not `usable` the last command is repeated.

        Raises:
            ValueError: the observation has another shape.
        """
        o = decoded_terms(observation)
        if not measured(terms := observation[..., :SIZE]):
            rows = np.atleast_2d(terms)
            action, good = last_commands(rows), usable(rows)
            if good.any():
                o = decoded_terms(rows[good])
                action[good] = np.stack(action_of(self.forces(o, ARRAYS), o, ARRAYS), axis=1)
            return action.reshape(*observation.shape[:-1], 2), state
        self.check(o)
        if observation.ndim == 1:
            return np.array(action_of(self.forces(o), o, FLOATS), dtype=np.float32), state
        return np.stack(action_of(self.forces(o, ARRAYS), o, ARRAYS), axis=1).astype(np.float32), state


def traceable(policy: Any) -> bool:
    """Return whether a policy does what its `forces` say: whether it is a `Law` with `Law.predict`."""
    return isinstance(policy, Law) and type(policy).predict is Law.predict


def preview_of(policy: Any) -> tuple[int, ...]:
    """Return the preview that a policy's observations need, its attribute `preview`; most policies need none."""
    return tuple(getattr(policy, "preview", ()))


def corrected(base: Number, authority: Number, correction: Number, ns: Namespace) -> Number:
    """Return the command of residual control, clip(base + authority * clip(correction)): surge, yaw, or both at once.

    Args:
        base: the expert's action, in [-1, 1].
        authority: largest correction.
        correction: of the learner; 1 is the largest.
        ns: the namespace of the numbers, which may have any shapes that fit together.
    """
    return ns.clip(base + authority * ns.clip(correction, -1.0, 1.0), -1.0, 1.0)


def checked_authority(authority: float | Sequence[float]) -> tuple[float, float]:
    """Return the largest correction of surge and yaw command as a pair.

    Raises:
        ValueError: it is neither a number nor a pair, or not in (0, 2].
    """
    pair = tuple(authority) if isinstance(authority, Sequence) else (authority, authority)
    if len(pair) != 2 or not all(isinstance(a, (int, float)) and 0 < a <= 2 for a in pair):
        raise ValueError(f"authority is {authority!r}; it must be a number in (0, 2], or one each for surge and yaw")
    return float(pair[0]), float(pair[1])
