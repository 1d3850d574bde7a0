"""A window of control steps: forward pass through vehicles and network, backward pass for the gradient."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from auv_gym.physics.namespaces import ARRAYS, AnyArray
from baselines.training.apg.closed_loop import Loss
from baselines.training.apg.kernels import LoopKernels, RunConstants, moved_rows
from baselines.training.apg.network import GruPass, MlpPass, NetworkArrays, TorchGru, TorchMlp

Act = Callable[[int, AnyArray], AnyArray]
"""Returns the actions of an expert at step k for observations (SIZE, N), shape (OUTPUTS, N)."""


SMALLEST = 0.002
"""Added to mean errors, in units of their scale, in `divided_by_error`; it bounds the weights of small errors."""
_LARGEST = 1000.0  # upper bound of mean errors in these weights
CARRIED = ("d_state", "d_observation", "d_integrals", "d_correction")
"""Derivatives that the backward pass carries from one control instant to the previous one."""


class Carried(NamedTuple):
    """The state from one control instant to the next: arrays whose last axis is that of the N vehicles."""

    state: AnyArray  # rows of a `simulation.Plant`, shape (`Parts.plant_rows`, N)
    observation: AnyArray  # shape (SIZE, N)
    integrals: AnyArray  # of the features, shape (`Inputs.memory`, N)
    correction: AnyArray  # the last one, shape (OUTPUTS, N)
    hidden: AnyArray  # of the network, shape (memory, N)


@dataclass(frozen=True)
class Objective:
    """The objective of a window."""

    loss: Loss  # of a control step; its weights may have shape (N,)
    shares: AnyArray  # weight of each vehicle in the mean loss, shape (N,)
    derivative_bound: float = 0.0  # of a vehicle in the backward pass, in medians over vehicles; 0: no bound
    error_exponent: float = 0.0  # see `divided_by_error`

    def of(self, vehicles: NDArray[np.int64]) -> Objective:
        """Return the objective of some of the vehicles, with the same shares."""
        loss = Loss(*(np.broadcast_to(weight, len(self.shares))[vehicles] for weight in self.loss))
        return replace(self, loss=loss, shares=self.shares[vehicles])


class TrainingWindow:
    """T control steps of N vehicles in the precision of the kernels; `run` can be called repeatedly.

    Args:
        kernels: of the closed loop.
        network: corrects the expert; its weights may change in place between windows.
        steps: T.
        authority: largest corrections of surge and yaw.
        objective: of the gradient.
    """

    def __init__(
        self,
        kernels: LoopKernels,
        network: TorchGru | TorchMlp,
        steps: int,
        authority: Sequence[float],
        objective: Objective,
    ) -> None:
        self.network, self.steps, self.objective = network, steps, objective
        self._exact, self._type = kernels.exact, np.dtype(kernels.precision)
        inputs, self._substeps = kernels.loop.inputs, kernels.loop.parts.substeps
        features, memory, n = len(inputs.features), network.sizes.memory, len(objective.shares)
        moved, self._model = moved_rows(kernels.loop.parts), kernels.loop.parts.model
        outputs, size = moved["correction"], self._model.layout.size
        self._carried = Carried(
            *(self._zeros(steps + 1, rows, n) for rows in (moved["state"], size, inputs.memory, outputs, memory))
        )
        self._ahead, self._samples, self._features, self._base, self._squared = (
            self._zeros(steps, rows, n)
            for rows in (self._model.layout.axes * len(inputs.preview), moved["sample"], features, outputs, 1)
        )
        self._parameters = self._zeros(moved["parameters"], n)
        chosen = (*authority, *RunConstants(*objective.loss, objective.shares / steps))
        self._chosen = np.array([np.broadcast_to(x, n) for x in chosen], dtype=self._type)
        self._known = {name: self._zeros(rows, n) for name, rows in kernels.seen.items() if name == "known"}
        self._d = {
            name: self._zeros(rows, n)
            for name, rows in (
                ("d_state", moved["state"]),
                ("d_observation", size),
                ("d_integrals", inputs.memory),
                ("d_base", outputs),
                ("d_correction", outputs),
                ("d_features", features),
            )
        }
        tensors = (self._features, self._carried.hidden, self._carried.correction)
        derivatives = (self._d["d_features"], self._d["d_correction"])
        arrays = NetworkArrays(*map(torch.from_numpy, (*tensors, *derivatives)))
        self._pass = GruPass(network, arrays) if isinstance(network, TorchGru) else MlpPass(network, arrays)
        self._bind(kernels)

    def _zeros(self, *shape: int) -> AnyArray:
        return np.zeros(shape, dtype=self._type)

    def _bind(self, kernels: LoopKernels) -> None:
        """Bind the kernels to their arrays."""
        before, after = (Carried(*(x[part] for x in self._carried)) for part in (slice(-1), slice(1, None)))
        seen = {
            "observation": before.observation,
            "correction": before.correction,
            "integrals": before.integrals,
            "ahead": self._ahead,
            "base": self._base,
            **self._known,
        }
        moved = {
            "state": before.state,
            "base": self._base,
            "correction": after.correction,
            "sample": self._samples,
            "parameters": self._parameters,
            "chosen": self._chosen,
        }
        d = self._d
        self._observe = kernels.observe.bound(**seen, features=self._features, following=after.integrals)
        self._move = kernels.move.bound(
            **moved, next_state=after.state, observation=after.observation, squared_error=self._squared
        )
        d_observe = {name: d[name] for name in d if name != "d_state"}
        d_move = {name: d[name] for name in ("d_state", "d_observation", "d_correction", "d_base")}
        self._observe_adjoint = kernels.observe_adjoint.bound(**seen, **d_observe)
        self._move_adjoint = kernels.move_adjoint.bound(**moved, **d_move)

    def run(
        self,
        carried: Carried,
        ahead: AnyArray,
        samples: AnyArray,
        parameters: AnyArray,
        act: Act,
        known: AnyArray,
    ) -> tuple[float, float, Carried, AnyArray]:
        """Run the window and set the gradients of the objective with respect to the network's weights.

        Args:
            carried: state at the start of the window; the backward pass ends here.
            ahead: the preview of the network's inputs in the world [m], shape (T, 2 P, N).
            samples: the rows of `simulation.Sample`s, shape (T, `Parts.sample_rows`, N).
            parameters: the rows of `simulation.Parameters`, shape (`Parts.parameter_rows`, N).
            act: the expert; it is called only if it is not in the kernels.
            known: the nominal models of the vehicles, shape (`known_rows`, N).

        Returns:
            The mean loss, without `error_exponent`, the mean position error [m], the state at the end of the window,
            which the next run overwrites, and the squared position error [m^2] there, shape (N,).
        """
        for rows, first in zip(self._carried, carried, strict=True):
            rows[0] = first
        self._ahead[:], self._samples[:], self._parameters[:] = ahead, samples, parameters
        for rows in self._known.values():
            rows[:] = known
        with torch.no_grad():
            self._forward(act)
            if exponent := self.objective.error_exponent:
                self._chosen[-1] = divided_by_error(self.objective.shares, self._errors(), exponent) / self.steps
            self._backward()
        with np.errstate(all="ignore"):  # errors of diverged vehicles may overflow
            mean, error = self._mean_loss(), float(np.sqrt(self._squared, dtype=np.float64).mean())
        return mean, error, Carried(*(x[-1] for x in self._carried)), self._squared[-1, 0]

    def _forward(self, act: Act) -> None:
        self._pass.begin()
        for k in range(self.steps):
            if not self._exact:
                self._base[k] = act(k, self._carried.observation[k])
            self._observe(k, 1)
            self._pass.forward(k)
            self._move(k, 1)

    def _backward(self) -> None:
        for derivative in self._d.values():
            derivative.fill(0.0)
        for k in reversed(range(self.steps)):
            self._move_adjoint(k, 1)
            self._pass.backward(k)
            self._observe_adjoint(k, 1)
            if bound := self.objective.derivative_bound:
                self._bound(bound)
        self._pass.finish()

    def _bound(self, bound: float) -> None:
        """Scale the derivatives of each vehicle down to `bound` medians over vehicles; set non-finite ones to zero."""
        carried = (*(self._d[name] for name in CARRIED), self._pass.d_hidden.numpy())
        with np.errstate(all="ignore"):
            size = np.sqrt(sum(np.einsum("ij,ij->j", d, d) for d in carried))
            share = np.where(np.isfinite(size), np.minimum(1.0, bound * np.median(size) / (size + 1e-30)), 0.0)
            for d in carried if (share < 1).any() else ():
                np.multiply(d, share, out=d)
            for d in carried if not share.all() else ():
                d[:, share == 0] = 0.0  # since 0 times nan is nan

    def _errors(self) -> AnyArray:
        """Return each vehicle's mean position error in the window, in units of its scale."""
        with np.errstate(all="ignore"):
            mean = np.sqrt(self._squared[:, 0], dtype=np.float64).mean(axis=0)
        return np.asarray(mean / self._parameters[self._model.parameters.error_scale])

    def _mean_loss(self) -> float:
        first, places = self._model.forces.stop, self._model.parameters
        actions = self._carried.state[:, first : self._model.plant_rows].swapaxes(0, 1)
        dt, scale = self._substeps * self._parameters[places.h], self._parameters[places.error_scale]
        of = self.objective.loss.of(self._squared[:, 0], scale, [*actions[:, 1:]], [*actions[:, :-1]], dt, ARRAYS)
        return float(np.mean(of @ self.objective.shares.astype(of.dtype), dtype=np.float64))


def divided_by_error(shares: AnyArray, errors: AnyArray, error_exponent: float) -> AnyArray:
    """Return shares with the same sum, divided by the errors to a power; a vehicle with a non-finite error has share 0.

    With exponent 0 the shares do not change, and the objective is a mean of errors. With exponent 1 its gradient is
    that of a mean of logarithms: halving an error of a millimetre counts as much as halving an error of a metre.

    Args:
        shares: weights of the vehicles, shape (N,).
        errors: of the vehicles, in units of their scales, shape (N,).
        error_exponent: 0 ... 1.
    """
    bounded = np.minimum(errors, _LARGEST) + SMALLEST
    divided = np.where(np.isfinite(errors), shares * bounded**-error_exponent, 0.0)
    total = divided.sum()
    return divided * (shares.sum() / total) if total > 0 else shares
