"""Policy of a trained agent: an expert's action plus a bounded correction by a network, without torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS, Symbol, single
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.namespaces import Array
from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle, with_names
from auv_gym.task.policy import Law, Policy, corrected, preview_of, traceable
from auv_gym.task.preview import shared_preview
from baselines.agents.features import STANDARD, Inputs
from baselines.agents.networks import OUTPUTS, Network, Weights
from baselines.agents.space_features import SpaceInputs
from baselines.policy import ALL_SPEEDS, Batched, Memory, Starts, renewed
from baselines.scaling import shown_factors

BLOCK = 128
"""Most vehicles in one call of the network, so that intermediate results stay in the processor's cache."""
_Symbols = Sequence[Symbol]


@lru_cache(maxsize=64)
def feature_kernel(
    inputs: Inputs | SpaceInputs,
    law: Law | None,
    vehicle: Vehicle | SpaceVehicle = PAPER_VEHICLE,
    units: Units = Units(),  # noqa: B008, it is frozen
) -> Kernel:
    """Return the kernel that computes the features from an observation and its preview, `ahead`.

    Its results are `terms`, those of the observation in SI units; `features` and `integrals`, see `Inputs.update`; and
    `base`, the expert's action.

    Args:
        inputs: features of the network.
        law: the expert, if it is a traceable law. None: the expert's action `base` is an input of the kernel.
        vehicle: the nominal one, in the paper's units, see `Inputs.update`.
        units: in which the features are computed from an observation in SI units. By default nothing is scaled.
    """
    layout = inputs.model.layout
    factors = () if units == Units() else shown_factors(units, layout)
    row: Any = vehicle.all_coefficients
    row, channels = row if isinstance(inputs, SpaceInputs) else with_names(row), len(inputs.model.channels)

    def equation(
        observation: _Symbols, ahead: _Symbols, correction: _Symbols, integrals: _Symbols, base: _Symbols = ()
    ) -> Mapping[str, _Symbols]:
        o = layout.decode(observation, SYMBOLS)
        if factors:
            o = [term * factor for term, factor in zip(o, factors, strict=True)]
            ahead = [distance * (1 / units.length) for distance in ahead]
        if law is not None:
            base = [single(a) for a in layout.action_of(law.forces(o, SYMBOLS), o, SYMBOLS)]  # as in `Law.predict`
        features, sums = inputs.update(o, ahead, base, correction, integrals, SYMBOLS, row)
        return {"terms": o, "features": features, "integrals": sums, "base": base}

    rows = {"observation": layout.size, "ahead": layout.axes * len(inputs.preview)}
    rows |= {"correction": channels, "integrals": inputs.memory}
    rows = rows if law is not None else rows | {"base": channels}
    return Kernel.traced(equation, rows, blocked=inputs.filters)


@lru_cache(maxsize=2)
def command_kernel(channels: int = OUTPUTS) -> Kernel:
    """Return the kernel of `corrected`, whose result is in single precision, as the actions of all policies."""

    def equation(base: _Symbols, authority: _Symbols, correction: _Symbols) -> Mapping[str, _Symbols]:
        rule = zip(base, authority, correction, strict=True)
        return {"command": [single(corrected(b, a, c, SYMBOLS)) for b, a, c in rule]}

    return Kernel.traced(equation, dict.fromkeys(("base", "authority", "correction"), channels))


class _Buffers:
    """Arrays for n vehicles, and the kernels that read and write them."""

    def __init__(self, n: int, features: Kernel) -> None:
        command = command_kernel(features.rows["correction"])
        rows = features.rows | command.rows
        self.arrays = {name: np.zeros((size, n)) for name, size in rows.items()}
        self.compute_features = features.bound(**{name: self.arrays[name] for name in features.rows})
        self.compute_command = command.bound(**{name: self.arrays[name] for name in command.rows})


class ResidualPolicy(Batched):
    """command = clip(expert + authority * network(features)).

    Its memory is that of its inputs, (N, `Inputs.memory`), the last correction, (N, 2), the hidden state of the
    network, (N, hidden), then the memory of the expert. With a correction of zero the command is exactly that of the
    expert. An instance must not be used by several threads at the same time.
    """

    remembers = True
    OWN = 3
    """Number of arrays of its memory before those of the expert."""

    def __init__(
        self,
        expert: Policy,
        network: Network,
        weights: Weights,
        authority: tuple[float, ...],
        inputs: Inputs | SpaceInputs = STANDARD,
        precision: str = "float64",
        speeds: tuple[float, float] = ALL_SPEEDS,
        vehicle: Vehicle | SpaceVehicle = PAPER_VEHICLE,
    ) -> None:
        """Make the policy.

        Args:
            expert: the policy that the network corrects.
            network: kind and sizes.
            weights: of the network, checked by `networks.check_weights`.
            authority: largest correction of surge and yaw, as fractions of the limits.
            inputs: features of the network.
            precision: of the network, "float64" or "float32".
            speeds: see `Batched`.
            vehicle: the nominal one, in the paper's units, see `Inputs.update`.
        """
        self.speeds = speeds
        self.inputs, self.layout = inputs, inputs.model.layout
        self.preview, self._seen, self._seen_by_expert = shared_preview(
            inputs.preview, preview_of(expert), self.layout.axes
        )
        self.expert, self.network, self.authority = expert, network, np.array(authority)
        self._layers, self.precision = network.prepared(weights, precision), np.dtype(precision)
        self._law = cast(Law, expert) if traceable(expert) else None
        uses = inputs.nominal_vehicle or isinstance(vehicle, SpaceVehicle)
        self._vehicle = vehicle if uses else PAPER_VEHICLE  # else all vehicles share one kernel
        self._buffers: tuple[int, _Buffers] | None = None
        self._buffers_for(1)  # compiles the kernels before the first action

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without addresses of memory."""
        return self.__dict__ | {"_buffers": None}

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory, see `Batched`."""
        del deterministic
        n = len(rows)
        integrals, correction, hidden = self._renewed(state, n, episode_start)
        buffers = self._buffers_for(n)
        arrays = buffers.arrays
        size = self.layout.size
        arrays["observation"][:] = rows[:, :size].T
        if self._seen:
            arrays["ahead"][:] = rows[:, size:].T[self._seen]
        arrays["correction"][:], arrays["integrals"][:] = correction.T, integrals.T
        past: Memory | None = state[self.OWN :] if state else ()
        if self._law is None:
            seen = np.hstack((rows[:, :size], rows[:, size:][:, self._seen_by_expert]))
            action, past = self.expert.predict(seen, past or None, episode_start)
            arrays["base"][:] = action.T
        buffers.compute_features(0, 1)
        if self._law is not None:
            terms = arrays["terms"]
            self._law.check(terms.ravel().tolist() if n == 1 else terms)
        correction, hidden = self._forward(arrays["features"].astype(self.precision, copy=False), hidden.T)
        arrays["correction"][:], arrays["authority"][:] = correction, self.authority[:, None]
        buffers.compute_command(0, 1)
        memory = arrays["integrals"].T.copy(), arrays["correction"].T.copy(), hidden.T, *(past or ())
        return arrays["command"].T.astype(np.float32), memory

    def _forward(self, features: Array, hidden: Array) -> tuple[Array, Array]:
        """Return correction and hidden state of `Network.forward`, computed in blocks of vehicles."""
        n = features.shape[1]
        if n <= BLOCK:
            return self.network.forward(self._layers, features, hidden)
        blocks = [slice(first, first + BLOCK) for first in range(0, n, BLOCK)]
        parts = [self.network.forward(self._layers, features[:, block], hidden[:, block]) for block in blocks]
        correction, hidden = (np.concatenate(rows, axis=1) for rows in zip(*parts, strict=True))
        return correction, hidden

    def _renewed(self, state: Memory | None, n: int, episode_start: Starts) -> Memory:
        """Return the memory of n vehicles without that of the expert, reset where an episode begins."""
        if state and len(state[0]) == n and (episode_start is None or not np.count_nonzero(episode_start)):
            return state[: self.OWN]
        initial = (
            np.zeros((n, self.inputs.memory)),
            np.zeros((n, len(self.authority))),
            np.zeros((n, self.network.memory), self.precision),
        )
        return renewed(state and state[: self.OWN], initial, episode_start)

    def _buffers_for(self, n: int) -> _Buffers:
        """Return the buffers for n vehicles; those of the last call are used again if it had the same number."""
        if self._buffers is None or self._buffers[0] != n:
            self._buffers = n, _Buffers(n, feature_kernel(self.inputs, self._law, self._vehicle))
        return self._buffers[1]
