"""One control step of expert, features and vehicle, with its loss: equations on components, for every namespace."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, cast

from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.rows import filled, leaves
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, Vehicle
from auv_gym.task import simulation
from auv_gym.task.observation import Observation, action_of, decode, encode
from auv_gym.task.policy import Forces, Law, Policy, corrected, traceable
from auv_gym.task.preview import preview_columns
from auv_gym.task.simulation import PLANT, Parameters, Parts
from baselines.agents.features import STANDARD, Inputs
from baselines.control.backstepping import Backstepping, tracking_forces
from baselines.control.ekf_law import EkfLaw
from baselines.policy import U_R, V_R, BySpeed, is_fast

LINEAR_FROM = 2.0  # error in units of its scale where the loss turns from a parabola into a logarithm
SQUARE_WEIGHT = 0.3  # weight of the squared error, in units of its scale, in the parabola
_TINY = 1e-6  # added to the squared error, in units of the scale's square: the distance has no slope at zero

_Rows = Sequence[Number]
"""Components, each a number of every vehicle."""


class Loss(NamedTuple):
    """Weights of the loss of a control step, for all vehicles or for each of them."""

    effort: Number = 0.003  # of the squared command
    rate: Number = 0.003  # [s^2] of its squared rate of change

    def of(
        self, squared_error: Number, scale: Number, command: _Rows, previous: _Rows, dt: Number, ns: Namespace
    ) -> Number:
        """Return the loss of a step.

        Near the reference it is e + 0.3 e^2 for an error of e scales; far from it, it grows like a logarithm, so that a
        vehicle that is lost neither outweighs all others nor ceases to be pulled back.

        Args:
            squared_error: of the position [m^2].
            scale: of the error [m].
            command: surge and yaw, in [-1, 1].
            previous: the ones before.
            dt: control period [s].
            ns: the namespace of the numbers.
        """
        e = ns.sqrt(squared_error / (scale * scale) + _TINY)
        near, far = ns.clip(e, 0.0, LINEAR_FROM), ns.clip(e, LINEAR_FROM, math.inf)
        slope = LINEAR_FROM * (1 + 2 * SQUARE_WEIGHT * LINEAR_FROM)
        error = near + SQUARE_WEIGHT * near * near + slope * ns.log(far / LINEAR_FROM)
        d_u, d_r = ((now - before) / dt for now, before in zip(command, previous, strict=True))
        a_u, a_r = command
        return error + self.effort * (a_u * a_u + a_r * a_r) + self.rate * (d_u * d_u + d_r * d_r)


class Moved(NamedTuple):
    """What a control step makes of the vehicles."""

    state: tuple[Number, ...]  # the rows of a `simulation.Plant`
    observation: tuple[Number, ...]  # its terms, encoded
    squared_error: Number  # [m^2] of the position
    loss: Number


@dataclass(frozen=True)
class ClosedLoop:
    """Expert, features and vehicle around a network, which is not part of it.

    Between two control instants `move`, at each of them `expert` and then `features`; their numbers are of any kind.
    """

    law: Forces
    inputs: Inputs = STANDARD  # of the network
    parts: Parts = Parts()  # noqa: RUF009 - a tuple; of the simulation, what is in use
    informed: Backstepping | None = None  # the expert, where known models differ: its `law` for any of them

    def expert(
        self, observation: _Rows, ns: Namespace, known: _Rows = PAPER_VEHICLE.coefficients
    ) -> tuple[Number, Number]:
        """Return the law's action on an observation without its preview; `informed` takes the known models."""
        o = decode(observation, ns)
        law = with_model(self.informed, Coefficients._make(known)) if self.informed else self.law
        return action_of(law(o, ns), o, ns)

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
        """Return what the network sees, and the integrals to hand in at the next control instant.

        Args:
            observation: without its preview.
            ahead: the preview of `inputs` in the world [m], x and y for each of its times.
            base: the expert's action.
            correction: the last one.
            integrals: of the features.
            ns: the namespace of the numbers.
            known: the coefficients of the known model.
        """
        o, hull = Observation._make(decode(observation, ns)), Coefficients._make(known)
        way = preview_columns(ahead, o, ns, self.parts.span)
        return self.inputs.update(o, way, base, correction, integrals, ns, hull)

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
        """Return what a control step makes of the vehicles.

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
        p, before = Parameters.of(parameters, self.parts), filled(PLANT, state)
        rule = zip(base, authority, correction, strict=True)
        command = [corrected(b, largest, c, ns) for b, largest, c in rule]
        plant, terms, (_, _, squared_error, _) = simulation.step(before, command, sample, p, ns)
        previous, dt = (before.a_u, before.a_r), self.parts.substeps * p.h
        failed = loss.of(squared_error, p.error_scale, command, previous, dt, ns)
        return Moved(leaves(plant), tuple(encode(terms, ns, self.parts.span)), squared_error, failed)


def with_model(expert: Backstepping, known: Coefficients) -> Forces:
    """Return the law of an expert with another known model, of any kind of numbers."""
    law = copy.copy(expert)
    law.vehicle = cast(Vehicle, known)  # whose fields it has
    return law.forces


def law_of(expert: Policy) -> tuple[Forces, bool]:
    """Return an expert's law on components, and whether that is the expert itself.

    An expert that computes on NumPy alone, with a memory perhaps, has its slope taken from a law near it: the one on an
    extended Kalman filter from the same law on the measurements, every other from the paper's law.
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
    return Backstepping().forces, False


def _by_speed(slow: EkfLaw, cruise: EkfLaw, o: Any, ns: Namespace) -> tuple[Any, Any]:
    fast = is_fast(o[U_R], o[V_R])
    slow_forces, cruise_forces = (tracking_forces(o, law.vehicle, law.gains, ns) for law in (slow, cruise))
    return ns.where(fast, cruise_forces[0], slow_forces[0]), ns.where(fast, cruise_forces[1], slow_forces[1])
