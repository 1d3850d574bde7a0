"""Preview: further columns of the observation that say where the reference will be, for policies that look ahead."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import Array, Indices, Namespace, Number
from auv_gym.planning.paths import Path, evaluate_paths
from auv_gym.task.observation import SIZE, L, Observation, bounds

_FARTHEST = 1000
"""Most control periods that a preview may look ahead."""


def checked_preview(preview: Any) -> tuple[int, ...]:
    """Return a preview as a tuple of ascending numbers of control periods.

    Raises:
        ValueError: it is no sequence of integers in [1, `_FARTHEST`], or they do not ascend.
    """
    periods = tuple(preview) if isinstance(preview, Sequence) and not isinstance(preview, str) else (None,)
    if not all(isinstance(n, int) and 1 <= n <= _FARTHEST for n in periods) or list(periods) != sorted(set(periods)):
        raise ValueError(
            f"preview is {preview!r}; it must be ascending numbers of control periods, integers in [1, {_FARTHEST}]"
        )
    return tuple(map(int, periods))


def shared_preview(mine: Sequence[int], theirs: Sequence[int]) -> tuple[tuple[int, ...], list[int], list[int]]:
    """Return the preview that serves two at once, and which of its columns are the one's and the other's."""
    preview = tuple(sorted({*mine, *theirs}))
    mine_of, theirs_of = (
        [column for n in periods for column in (2 * preview.index(n), 2 * preview.index(n) + 1)]
        for periods in (mine, theirs)
    )
    return preview, mine_of, theirs_of


def columns_behind(rows: NDArray[Any], preview: Sequence[int]) -> NDArray[Any]:
    """Return what observations, shape (N, n), hold behind their terms: a preview's columns, and perhaps more.

    Raises:
        ValueError: there are fewer than a policy with this preview needs.
    """
    extra = rows[:, SIZE:]
    if extra.shape[1] < 2 * len(preview):
        raise ValueError(
            f"the observation has {extra.shape[1]} columns behind its terms, the policy needs a preview of "
            f"{2 * len(preview)}: make the environment with preview=policy.preview"
        )
    return extra


def observation_bounds(preview: tuple[int, ...], span: int) -> Array:
    """Return the bounds of an observation with a preview, shape (SIZE + 2 P,); for the span see `task.bounds`."""
    return np.append(bounds(span), np.full(2 * len(preview), L * span))


class Preview:
    """Positions of the references of N lanes, up to P control periods ahead.

    A preview's columns are, for each of its times, the displacement x, y [m] of the reference from where it is now to
    where it will be, along the measured body axes; the scale is 1 and the bound `task.L`, as many times as wide for a
    ship as that of other lengths. Behind an episode's last instant the path goes on, and behind a path's end it goes
    straight on at its last velocity.
    """

    def __init__(self, lanes: int, periods: Sequence[int], steps: int) -> None:
        """Make room for lanes whose episodes have up to `steps` control steps.

        Raises:
            ValueError: see `checked_preview`.
        """
        self.periods = checked_preview(periods)
        self._ahead = np.array(self.periods, dtype=np.int64)
        self._instants, self._last = steps + 1 + max(self.periods, default=0), steps
        self._positions = np.zeros((lanes if self.periods else 0, self._instants, 2))

    @property
    def columns(self) -> int:
        """How many columns it adds to an observation."""
        return 2 * len(self.periods)

    def load(self, lanes: Sequence[int] | Indices, paths: Sequence[Path], dt: float, tables: Sequence[Array]) -> None:
        """Take up new episodes: their paths, their control period [s] and their reference tables, of one length."""
        if not self.periods:
            return
        known = len(tables[0])
        times: Array = dt * np.arange(known, self._instants, dtype=np.float64)
        self._positions[lanes, :known] = [table[:, :2] for table in tables]
        self._positions[lanes, known:] = _positions(paths, times)

    def ahead(self, lanes: Sequence[int] | Indices, k: int | Indices) -> Array:
        """Return the displacements in the world [m] from control step k of n lanes on, shape (P, 2, n).

        Behind the last control step, where an episode that is over waits for its reset, they are those of that step.
        """
        lanes, k = np.asarray(lanes), np.broadcast_to(np.minimum(k, self._last), len(lanes))
        now = self._positions[lanes, k]
        later = self._positions[lanes[:, None], k[:, None] + self._ahead]
        return np.asarray((later - now[:, None]).transpose(1, 2, 0))


def encode_preview(ahead: Any, o: Observation, ns: Namespace, span: int) -> Any:
    """Return a preview's columns as rows, shape (2 P, n), for displacements in the world [m], shape (P, 2, n).

    `o` is the observation, whose measured heading alone counts; `ns` is the namespace of arrays or tensors; see
    `task.bounds` for the span.
    """
    return ns.stack(preview_columns(ahead.reshape(2 * len(ahead), -1), o, ns, span))


def preview_columns(ahead: Sequence[Number], o: Observation, ns: Namespace, span: int) -> tuple[Number, ...]:
    """Return what `encode_preview` does as components, for as many displacements x, y, x, y, ... [m] of any numbers."""
    ways = zip(ahead[::2], ahead[1::2], strict=True)
    far = L * span
    return tuple(ns.clip(z, -far, far) for x, y in ways for z in to_body(x, y, o.cos_psi, o.sin_psi))


def _positions(paths: Sequence[Path], t: Array) -> Array:
    """Return the positions [m] of N paths at T times, shape (N, T, 2)."""
    out = np.empty((len(paths), len(t), 2))
    endless = [i for i, path in enumerate(paths) if path.end >= t[-1]]
    if endless:
        out[endless] = evaluate_paths([paths[i] for i in endless], t)[0].transpose(2, 1, 0)
    for i in set(range(len(paths))) - set(endless):
        known = np.minimum(t, paths[i].end)
        position, velocity = paths[i].derivatives(known)[:2]
        out[i] = (position + velocity * (t - known)).T
    return out
