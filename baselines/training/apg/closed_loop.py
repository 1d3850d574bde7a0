"""One control step of expert, features and vehicle, with its loss: equations on components, for every namespace."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, cast

from auv_gym.effects.mismatch import CrossFlow
from auv_gym.physics.namespaces import Namespace, Number, sum_of_squares
from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.vehicle import PAPER_VEHICLE, PARAMETER_NAMES, Coefficients, with_names
from auv_gym.scenarios.vehicles import PAPER
from auv_gym.task import simulation
from auv_gym.task.observation import PLANE_LAYOUT
from auv_gym.task.policy import Forces, Law, Policy, corrected, traceable
from auv_gym.task.preview import preview_columns
from auv_gym.task.simulation import Parts
from baselines.agents.features import STANDARD, Inputs
from baselines.agents.space_features import SpaceInputs
from baselines.control.backstepping import Backstepping, tracking_forces
from baselines.control.ekf_law import EkfLaw
from baselines.policy import U_R, V_R, BySpeed, is_fast
from baselines.space.backstepping import SpaceBackstepping

LINEAR_FROM = 2.0  # error in units of its scale from which the loss is logarithmic
SQUARE_WEIGHT = 0.3  # weight of the squared error, in units of its scale, below that
STEEP = 0.8
"""Pitch [rad] from which it costs."""
STEEP_WEIGHT = 20.0  # [1/rad^2] of the squared pitch beyond it
_TINY = 1e-6  # added to the squared error in units of the squared scale, since its root has no derivative at zero

_Rows = Sequence[Number]
"""Components; each holds one number per vehicle."""


class Loss(NamedTuple):
    """Weights of the loss of a control step; equal for all vehicles, or one number per vehicle."""

    effort: Number = 0.003  # of the squared command
    rate: Number = 0.003  # [s^2] of its squared rate of change

    def of(
        self, squared_error: Number, scale: Number, command: _Rows, previous: _Rows, dt: Number, ns: Namespace
    ) -> Number:
        """Return the loss of a step.

        Near the reference it is e + 0.3 e^2 for an error of e scales. Far from it the loss is logarithmic: a diverged
        vehicle does not outweigh all others, but its gradient is not zero.

        Args:
            squared_error: of the position [m^2].
            scale: of the error [m].
            command: of each channel, in [-1, 1].
            previous: the previous command.
            dt: control period [s].
            ns: the namespace of the numbers.
        """
        e = ns.sqrt(squared_error / (scale * scale) + _TINY)
        near, far = ns.clip(e, 0.0, LINEAR_FROM), ns.clip(e, LINEAR_FROM, math.inf)
        slope = LINEAR_FROM * (1 + 2 * SQUARE_WEIGHT * LINEAR_FROM)
        error = near + SQUARE_WEIGHT * near * near + slope * ns.log(far / LINEAR_FROM)
        rates = ((now - before) / dt for now, before in zip(command, previous, strict=True))
        return error + self.effort * sum_of_squares(command) + self.rate * sum_of_squares(rates)


class Moved(NamedTuple):
    """The vehicles after a control step."""

    state: tuple[Number, ...]  # the rows of a `simulation.Plant`
    observation: tuple[Number, ...]  # encoded terms
    squared_error: Number  # [m^2] of the position
    loss: Number


@dataclass(frozen=True)
class ClosedLoop:
    """The closed loop without its network: expert, features and vehicle, for every namespace.

    At each control instant call `expert`, then `features`; then `move` for the step to the next instant.
    """

    law: Forces
    inputs: Inputs | SpaceInputs = STANDARD  # of the network
    parts: Parts = Parts()  # noqa: RUF009 - a tuple; of the simulation
    informed: Backstepping | None = None  # the expert, if the nominal models of the vehicles differ
    in_space: SpaceVehicle = PAPER.in_space  # nominal vehicle of motion in space, the same for all

    def expert(
        self, observation: _Rows, ns: Namespace, known: _Rows = PAPER_VEHICLE.coefficients
    ) -> tuple[Number, ...]:
        """Return the law's action for an observation without its preview; `known` are the nominal models."""
        o = self.parts.model.layout.decode(observation, ns)
        law = with_model(self.informed, with_names(known)) if self.informed else self.law
        return self.parts.model.layout.action_of(law(o, ns), o, ns)

    def features(
        self,
        observation: _Rows,
        ahead: _Rows,
        base: _Rows,
        correction: _Rows,
        integrals: _Rows,
        ns: Namespace,
        known: _Rows = PAPER_VEHICLE.coefficients,
    ) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
        """Return the features and their new memory.

        Args:
            observation: without its preview.
            ahead: the preview of `inputs` in the world [m], x and y for each of its times.
            base: the expert's action.
            correction: the previous one.
            integrals: memory of the features.
            ns: the namespace of the numbers.
            known: the nominal models, `known_rows` of them.
        """
        model = self.parts.model
        row: Any = self.in_space.all_coefficients if isinstance(self.inputs, SpaceInputs) else with_names(known)
        o = model.Observation._make(model.layout.decode(observation, ns))
        preview = preview_columns(ahead, o, ns, self.parts.bound_factor, model)
        return self.inputs.update(o, preview, base, correction, integrals, ns, row)

    def move(
        self,
        state: _Rows,
        base: _Rows,
        correction: _Rows,
        sample: _Rows,
        parameters: _Rows,
        authority: _Rows,
        loss: Loss,
        ns: Namespace,
    ) -> Moved:
        """Return the vehicles after a control step.

        Args:
            state: the rows of a `simulation.Plant`.
            base: the expert's action.
            correction: the network's.
            sample: the rows of a `simulation.Sample`.
            parameters: the rows of `simulation.Parameters`.
            authority: largest corrections.
            loss: of the step.
            ns: the namespace of the numbers.
        """
        p, before = self.parts.parameters(parameters), self.parts.plant(state)
        rule = zip(base, authority, correction, strict=True)
        command = [corrected(b, largest, c, ns) for b, largest, c in rule]
        plant, terms, (_, _, squared_error, _) = simulation.step(before, command, sample, p, ns)
        model, dt = self.parts.model, self.parts.substeps * p.h
        previous = before[model.forces.stop : -1]
        step_loss = loss.of(squared_error, p.error_scale, command, previous, dt, ns)
        if "theta" in model.state:
            step_loss = step_loss + steep(plant.theta, ns)
        rows = tuple(model.layout.encode(terms, ns, self.parts.bound_factor))
        return Moved(simulation.plant_row(plant), rows, squared_error, step_loss)


def steep(theta: Number, ns: Namespace) -> Number:
    """Return the loss of a pitch [rad] beyond `STEEP`: an episode ends at `effects.space.MAX_PITCH`."""
    beyond = ns.clip(abs(theta) - STEEP, 0.0, math.inf)
    return STEEP_WEIGHT * beyond * beyond


def known_rows(parts: Parts) -> int:
    """Return the number of rows of nominal models: `Vehicle.all_coefficients`, with cross terms if any vehicle has."""
    return len(PARAMETER_NAMES) if CrossFlow in parts.effects else len(Coefficients._fields)


def with_model(expert: Backstepping, known: Coefficients) -> Forces:
    """Return the law of an expert with another nominal model, whose numbers may be symbols."""
    law = copy.copy(expert)
    vars(law)["vehicle"] = known  # not checked: it has the fields of a vehicle
    return law.forces


def law_of(expert: Policy) -> tuple[Forces, bool]:
    """Return a law on components for the derivatives of an expert, and whether this law is the expert itself.

    The derivatives of an expert that only accepts NumPy arrays are approximated by those of a similar law. For a law
    with an extended Kalman filter this is the law without the filter, for every other expert the paper's law.
    """
    if traceable(expert):
        return cast(Law, expert).forces, True
    controller = getattr(expert, "controller", None)
    if (
        isinstance(controller, BySpeed)
        and isinstance(controller.slow, EkfLaw)
        and isinstance(controller.cruise, EkfLaw)
    ):
        return partial(_by_speed, controller.slow, controller.cruise), False
    in_space = getattr(expert, "layout", PLANE_LAYOUT) != PLANE_LAYOUT
    return (SpaceBackstepping() if in_space else Backstepping()).forces, False


def _by_speed(slow: EkfLaw, cruise: EkfLaw, o: Any, ns: Namespace) -> tuple[Any, Any]:
    fast = is_fast(o[U_R], o[V_R])
    slow_forces, cruise_forces = (tracking_forces(o, law.vehicle, law.gains, ns) for law in (slow, cruise))
    return ns.where(fast, cruise_forces[0], slow_forces[0]), ns.where(fast, cruise_forces[1], slow_forces[1])
