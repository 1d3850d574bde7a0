"""The kernels of a window: the computations before and after the network in a control step, and their adjoints.

An adjoint computes its step again from the inputs of the step, so that no intermediate values are stored. An array
named d_X holds the derivatives of the window's loss with respect to X.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from auv_gym.codegen.derivatives import gradient
from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Equation, Kernel
from auv_gym.physics.namespaces import Number
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.task.model import Model
from auv_gym.task.simulation import Parts
from baselines.training.apg.closed_loop import ClosedLoop, Loss, Moved, known_rows

_Symbols = Sequence[Symbol]
_Results = Mapping[str, _Symbols]


class RunConstants(NamedTuple):
    """Constants of a run, after the authority of each channel.

    They are inputs of the kernels, so that all runs use the same compiled library.
    """

    effort: Number  # see `Loss`
    rate: Number
    share: Number  # weight of a control step of a vehicle in the window's loss


FIXED = frozenset(
    ("parameters", "chosen", "known", "d_state", "d_observation", "d_base", "d_correction", "d_features", "d_integrals")
)
"""Arrays without a time axis."""
_PAPER = PAPER_VEHICLE.coefficients


def moved_rows(parts: Parts) -> dict[str, int]:
    """Return the inputs of a control step with their numbers of rows."""
    channels = len(parts.model.channels)
    return {
        "state": parts.plant_rows,
        "base": channels,
        "correction": channels,
        "sample": parts.sample_rows,
        "parameters": parts.parameter_rows,
        "chosen": channels + len(RunConstants._fields),
    }


def steered(model: Model) -> list[int]:
    """Return the terms of an observation that depend on the vehicle's motion; only these have derivatives.

    They are all but reference, surge limit and control period. The largest torque is included, since that of fins
    depends on the speed.
    """
    names = [term.name for term in model.layout.terms]
    others = [name for name in names if name.endswith("R")] + ["F_u_max", "dt"]
    return [i for i, name in enumerate(names) if name not in others]


@dataclass(frozen=True)
class LoopKernels:
    """The four kernels of a closed loop.

    Args:
        loop: the equations.
        exact: whether `loop.law` is the expert; else the action is an input, and the law only gives the derivatives.
        precision: "float32" or "float64".
    """

    loop: ClosedLoop
    exact: bool
    precision: str = "float32"

    @cached_property
    def observe(self) -> Kernel:
        """The kernel of features and expert's action, from observation, preview, last correction and integrals."""

        def equation(**arrays: _Symbols) -> _Results:
            action, features, following = self._observed(**arrays)
            return {"features": features, "following": following, **({} if "base" in arrays else {"base": action})}

        return self._traced(equation, self.seen if self.exact else self.seen | {"base": self._channels})

    @cached_property
    def observe_adjoint(self) -> Kernel:
        """The adjoint of `observe`, from the derivatives of its results to those of its inputs."""

        def equation(d_features: _Symbols, d_base: _Symbols, d_integrals: _Symbols, **arrays: _Symbols) -> _Results:
            _, features, following = self._observed(**arrays)
            observation, places = arrays["observation"], steered(self.loop.parts.model)
            moving = [observation[i] for i in places]
            kept = [i for i in range(self.loop.inputs.memory) if i not in self.loop.inputs.constants]
            remembered, results = ([rows[i] for i in kept] for rows in (arrays["integrals"], following))
            within = (*moving, *arrays["correction"], *remembered, *arrays["base"])
            shares = _split(
                gradient((*features, *results), (*d_features, *(d_integrals[i] for i in kept)), within),
                len(moving), self._channels, len(kept), self._channels,
            )  # fmt: skip
            action = self.loop.expert(observation, SYMBOLS, arrays.get("known", _PAPER))
            through_law = gradient(action, _sum(d_base, shares[3]), moving)
            terms: dict[int, Any] = dict(zip(places, _sum(shares[0], through_law), strict=True))
            sums: dict[int, Any] = dict(zip(kept, shares[2], strict=True))
            return {
                "d_observation": [terms.get(i, 0.0) for i in range(len(observation))],
                "d_correction": shares[1],
                "d_integrals": [sums.get(i, 0.0) for i in range(self.loop.inputs.memory)],
            }

        after = {
            "d_features": len(self.loop.inputs.features),
            "d_base": self._channels,
            "d_integrals": self.loop.inputs.memory,
        }
        return self._traced(equation, self.seen | {"base": self._channels} | after)

    @cached_property
    def move(self) -> Kernel:
        """The kernel of a control step: next state, observation and squared error, from state, actions and sample."""

        def equation(**arrays: _Symbols) -> _Results:
            moved = self._moved(**arrays)
            return {
                "next_state": moved.state,
                "observation": moved.observation,
                "squared_error": (moved.squared_error,),
            }

        return self._traced(equation, moved_rows(self.loop.parts))

    @cached_property
    def move_adjoint(self) -> Kernel:
        """The adjoint of `move`, from the derivatives of its results to those of state, action and correction."""

        def equation(
            d_state: _Symbols, d_observation: _Symbols, d_correction: _Symbols, **arrays: _Symbols
        ) -> _Results:
            moved = self._moved(**arrays)
            share = RunConstants._make(arrays["chosen"][self._channels :]).share
            within = (*arrays["state"], *arrays["base"], *arrays["correction"])
            shares = gradient((*moved.state, *moved.observation, moved.loss), (*d_state, *d_observation, share), within)
            state, base, correction = _split(shares, len(arrays["state"]), self._channels, self._channels)
            return {"d_state": state, "d_base": base, "d_correction": _sum(d_correction, correction)}

        rows = moved_rows(self.loop.parts)
        size = self.loop.parts.model.layout.size
        after = {"d_state": rows["state"], "d_observation": size, "d_correction": self._channels}
        return self._traced(equation, rows | after)

    @property
    def _channels(self) -> int:
        return len(self.loop.parts.model.channels)

    @property
    def seen(self) -> dict[str, int]:
        """Inputs of the features with their numbers of rows; `known` if the network has the nominal models."""
        inputs = self.loop.inputs
        known = {"known": known_rows(self.loop.parts)} if inputs.nominal_vehicle else {}
        layout = self.loop.parts.model.layout
        rows = {"observation": layout.size, "correction": self._channels}
        return rows | {"integrals": inputs.memory, "ahead": layout.axes * len(inputs.preview)} | known

    def _observed(
        self,
        observation: _Symbols,
        correction: _Symbols,
        integrals: _Symbols,
        ahead: _Symbols,
        base: _Symbols = (),
        known: _Symbols = _PAPER,
    ) -> tuple[_Symbols, _Symbols, _Symbols]:
        """Return the expert's action, which is `base` if it is an input, the features, and their new memory."""
        action = base or self.loop.expert(observation, SYMBOLS, known)
        return action, *self.loop.features(observation, ahead, action, correction, integrals, SYMBOLS, known)

    def _moved(
        self,
        state: _Symbols,
        base: _Symbols,
        correction: _Symbols,
        sample: _Symbols,
        parameters: _Symbols,
        chosen: _Symbols,
    ) -> Moved:
        of_run = RunConstants._make(chosen[self._channels :])
        loss = Loss(of_run.effort, of_run.rate)
        return self.loop.move(state, base, correction, sample, parameters, chosen[: self._channels], loss, SYMBOLS)

    def _traced(self, equation: Equation, rows: Mapping[str, int]) -> Kernel:
        arrays = {*rows, "features", "following", "next_state", "observation", "squared_error", "base"}
        over_time = sorted(arrays - FIXED)
        long = self.loop.inputs.filters and "ahead" in rows  # the equations of the filters
        return Kernel.traced(equation, rows, over_time, precision=self.precision, structural=True, blocked=long)


def _sum(a: _Symbols, b: _Symbols) -> list[Symbol]:
    return [x + y for x, y in zip(a, b, strict=True)]


def _split(symbols: _Symbols, *sizes: int) -> list[_Symbols]:
    parts, at = [], 0
    for size in sizes:
        parts.append(symbols[at : at + size])
        at += size
    return parts
