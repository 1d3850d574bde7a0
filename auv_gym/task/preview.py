"""Preview: additional columns of the observation with future positions of the reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import ARRAYS, Array, Indices, Namespace, Number
from auv_gym.planning.paths import Path, evaluate_paths
from auv_gym.planning.paths.space import SpacePath
from auv_gym.task.model import PLANE, Model
from auv_gym.task.observation import PLANE_LAYOUT, L, Layout

_FARTHEST = 1000
"""Largest number of control periods of a preview."""


def checked_preview(preview: Any) -> tuple[int, ...]:
    """Return a preview as a tuple of ascending numbers of control periods.

    Raises:
        ValueError: it is not a sequence of ascending integers in [1, `_FARTHEST`].
    """
    preview = preview.tolist() if isinstance(preview, np.ndarray) else preview
    periods = tuple(preview) if isinstance(preview, Sequence) and not isinstance(preview, str) else (None,)
    whole = all(isinstance(n, (int, np.integer)) and 1 <= n <= _FARTHEST for n in periods)
    if not whole or list(periods) != sorted(set(periods)):
        raise ValueError(
            f"preview is {preview!r}; it must be ascending numbers of control periods, integers in [1, {_FARTHEST}]"
        )
    return tuple(map(int, periods))


def shared_preview(
    mine: Sequence[int], theirs: Sequence[int], axes: int = 2
) -> tuple[tuple[int, ...], list[int], list[int]]:
    """Return the union of two previews, and the columns of each in it; each time has one for each of the axes."""
    preview = tuple(sorted({*mine, *theirs}))
    mine_of, theirs_of = (
        [axes * preview.index(n) + k for n in periods for k in range(axes)] for periods in (mine, theirs)
    )
    return preview, mine_of, theirs_of


def columns_behind(rows: NDArray[Any], preview: Sequence[int], layout: Layout = PLANE_LAYOUT) -> NDArray[Any]:
    """Return the columns of observations, shape (N, n), after the terms: those of a preview, and further ones.

    Raises:
        ValueError: there are fewer columns than those of the preview.
    """
    extra, needed = rows[:, layout.size :], layout.axes * len(preview)
    if extra.shape[1] < needed:
        raise ValueError(
            f"the observation has {extra.shape[1]} columns after its terms, the policy needs a preview of "
            f"{needed}: make the environment with preview=policy.preview"
        )
    return extra


def observation_bounds(preview: tuple[int, ...], bound_factor: int, model: Model = PLANE) -> Array:
    """Return the bounds of an observation with a preview of P times, shape (size + axes P,); see `Layout.bounds`."""
    further = len(model.position) * len(preview)
    return np.append(model.layout.bounds(bound_factor), np.full(further, L * bound_factor))


class Preview:
    """Future positions of the references of N sub-environments, P control periods ahead.

    The columns of a preview are, for each of its times, the displacement [m] of the reference from now to this time
    along the measured body axes, two numbers in the plane and three in space. The scale is 1, the bound is `L` times
    the bound factor, see `bounds`. After the last instant of an episode the path continues. After the end of a path the
    reference has its last velocity.
    """

    def __init__(self, num_envs: int, periods: Sequence[int], steps: int, axes: int = 2) -> None:
        """Allocate memory for sub-environments whose episodes have up to `steps` control steps.

        Raises:
            ValueError: see `checked_preview`.
        """
        self.periods = checked_preview(periods)
        self._ahead = np.array(self.periods, dtype=np.int64)
        self._instants, self._last = steps + 1 + max(self.periods, default=0), steps
        self._positions = np.zeros((num_envs if self.periods else 0, self._instants, axes))

    @property
    def columns(self) -> int:
        """Number of columns added to an observation."""
        return self._positions.shape[-1] * len(self.periods)

    def load(self, indices: Sequence[int] | Indices, paths: Sequence[Path], dt: float, tables: Sequence[Array]) -> None:
        """Load new episodes: their paths, control period [s] and reference tables, which have the same length."""
        if not self.periods:
            return
        known = len(tables[0])
        times: Array = dt * np.arange(known, self._instants, dtype=np.float64)
        self._positions[indices, :known] = [table[:, : self._positions.shape[-1]] for table in tables]
        self._positions[indices, known:] = _positions(paths, times)

    def ahead(self, indices: Sequence[int] | Indices, k: int | Indices) -> Array:
        """Return the displacements in the world [m] of n sub-environments from control step k on, shape (P, axes, n).

        After the last control step, while an episode that has ended waits for its reset, they are those of that step.
        """
        indices, k = np.asarray(indices), np.broadcast_to(np.minimum(k, self._last), len(indices))
        now = self._positions[indices, k]
        later = self._positions[indices[:, None], k[:, None] + self._ahead]
        return np.asarray((later - now[:, None]).transpose(1, 2, 0))


def with_preview(rows: Array, ahead: Array, bound_factor: int, model: Model = PLANE) -> Array:
    """Return observations with their previews, a new array (size + axes P, n).

    Args:
        rows: the observations, shape (size, n) or more rows.
        ahead: displacements in the world [m], see `Preview.ahead`, shape (P, axes, n).
        bound_factor: see `Layout.bounds`.
        model: of the observations.
    """
    o = model.Observation._make(model.layout.decode(rows[: model.layout.size], ARRAYS))
    flat = [*ahead.reshape(-1, ahead.shape[-1])]
    return np.vstack((rows, *preview_columns(flat, o, ARRAYS, bound_factor, model)))


def preview_columns(
    ahead: Sequence[Number], o: Any, ns: Namespace, bound_factor: int, model: Model = PLANE
) -> tuple[Number, ...]:
    """Return the columns of a preview as components, for displacements x, y, x, y, ... [m] of any numbers."""
    axes, far = len(model.position), L * bound_factor
    each = (model.displaced(ahead[k : k + axes], o, ns) for k in range(0, len(ahead), axes))
    return tuple(ns.clip(x, -far, far) for displacement in each for x in displacement)


def _positions(paths: Sequence[Any], t: Array) -> Array:
    """Return the positions [m] of N paths at T times, shape (N, T, axes)."""
    out = np.empty((len(paths), len(t), 3 if isinstance(paths[0], SpacePath) else 2))
    planar = not isinstance(paths[0], SpacePath)
    endless = [i for i, path in enumerate(paths) if path.end >= t[-1] and planar]
    if endless:
        out[endless] = evaluate_paths([paths[i] for i in endless], t)[0].transpose(2, 1, 0)
    for i in set(range(len(paths))) - set(endless):
        known = np.minimum(t, paths[i].end)
        position, velocity = paths[i].derivatives(known)[:2]
        out[i] = (position + velocity * (t - known)).T
    return out
