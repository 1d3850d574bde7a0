"""Autopilots of a vehicle that takes setpoints: heading, surge speed and in space depth are the actions.

The heading autopilot has the reference model and the sliding surface of T. I. Fossen, Handbook of Marine Craft
Hydrodynamics and Motion Control, 2nd ed., 2021, sections 12.1.1 and 16.4.4, without the switching term. It is then a
PID controller, as the same loop with the switching term is inside of its boundary layer.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, NamedTuple

from auv_gym.effects.actuators import known_torque
from auv_gym.effects.base import At, Effect, effect
from auv_gym.physics.dynamics import Force
from auv_gym.physics.intervals import Interval
from auv_gym.physics.namespaces import Namespace, Number, wrap_angle

LARGEST_TURN = 0.5 * math.pi
"""Heading setpoint less the heading of the reference [rad] at action 1."""
LARGEST_RISE = 5.0
"""Depth of the reference less the depth setpoint at action -1, as a travel time [s] of the reference."""
STEEPEST = 0.6  # [rad] largest pitch that the depth autopilot adds to that of the reference
_SLOWEST = 0.1  # [m/s] least speed by which the depth autopilot divides


def _surge(action: Number, m: Any, at: At, vehicle: Any, limit: Number) -> tuple[Number, Any]:
    """Return the share of the largest thrust: drag at the filtered setpoint, and PI control of the speed."""
    w, dt = at.own.speed, at.dt
    u_d, error = m.u_d + dt * w * (m.u_R * (1.0 + action) - m.u_d), m.u - m.u_d
    rate = w * (m.u_R * (1.0 + action) - m.u_d) - 2.0 * w * error - w * w * m.I_u
    share = ((vehicle.d11 + vehicle.X_uu * abs(m.u_d)) * m.u_d + vehicle.m11 * rate) / limit
    return share, m._replace(u_d=u_d, I_u=_integral(m.I_u, error, share, dt, at.ns))


def _heading(action: Number, m: Any, at: At, vehicle: Any, limit: Number) -> tuple[Number, Any]:
    """Return the share of the largest yaw moment, and the next state of the reference model of third order."""
    own, dt, ns = at.own, at.dt, at.ns
    w, off = own.model, wrap_angle(m.psi_R + LARGEST_TURN * action - m.psi_d, ns)
    jerk = w * (w * (w * off - 3.0 * m.r_d) - 3.0 * m.a_d)
    error, slip = wrap_angle(m.psi - m.psi_d, ns), m.r - m.r_d
    moment = _sliding(error, slip, m.I_r, (m.r_d, m.a_d), (vehicle.m33, vehicle.d33 + vehicle.N_ur * abs(m.u)), own)
    share = moment / known_torque(m.u, own.fin_r, limit, ns)
    a_d = m.a_d + dt * jerk
    r_d = ns.clip(m.r_d + dt * a_d, -own.turn, own.turn)
    return share, m._replace(psi_d=m.psi_d + dt * r_d, r_d=r_d, a_d=a_d, I_r=_integral(m.I_r, error, share, dt, ns))


def _depth(action: Number, m: Any, at: At, limit: Number) -> tuple[Number, Any]:
    """Return the share of the largest pitch moment: depth by pitch, and pitch as the heading, without a model."""
    own, dt, ns, c = at.own, at.dt, at.ns, at.vehicle
    high = m.z - (m.z_R - LARGEST_RISE * m.u_R * action)
    per_U = 1.0 / ns.clip(m.u, _SLOWEST, math.inf)
    dive = ns.clip(own.depth * per_U * (high + 0.25 * own.depth * m.I_z), -STEEPEST, STEEPEST)  # nose down
    error = m.theta - m.theta_R - dive
    inertia = c.upright.m33, c.upright.d33 + c.upright.N_ur * abs(m.u)
    moment = _sliding(error, m.q, m.I_q, (0.0, 0.0), inertia, own) + c.stiffness * ns.sin(m.theta)
    share = moment / known_torque(m.u, own.fin_q, limit, ns)
    I_z = ns.where(abs(dive) < STEEPEST, m.I_z + dt * high, m.I_z)
    return share, m._replace(I_z=I_z, I_q=_integral(m.I_q, error, share, dt, ns))


def _sliding(
    error: Number, slip: Number, total: Number, desired: tuple[Number, Number], model: tuple[Number, Number], own: Any
) -> Number:
    """Return the moment [N m] that brings an angle to sigma = slip + 2 lambda error + lambda^2 total = 0.

    Args:
        error: of the angle [rad].
        slip: of its rate [rad/s].
        total: integral of the error [rad s].
        desired: rate [rad/s] and acceleration [rad/s^2].
        model: inertia [kg m^2] and linear damping [kg m^2/s].
        own: numbers of the autopilot.
    """
    (rate, acceleration), (inertia, drag), k = desired, model, own.heading
    sigma = slip + 2.0 * k * error + k * k * total
    wanted, change = rate - 2.0 * k * error - k * k * total, acceleration - 2.0 * k * slip - k * k * error
    return inertia * (change - own.damping * sigma) + drag * wanted


def _integral(total: Number, error: Number, share: Number, dt: Number, ns: Namespace) -> Number:
    """Return the integral of an error after a control period; it is constant while the actuator is at its limit."""
    return ns.where(abs(share) < 1.0, total + dt * error, total)


@effect
class Autopilot(Effect):
    """Actions are setpoints, relative to the reference; autopilots command the actuators.

    Surge speed u_R (1 + a_u), heading psi_R + a_r pi / 2, in space depth: that of the reference plus 5 s u_R a_q. The
    autopilots use the measurements of the control instant. Their gains are for the true vehicle, as a maker sets them.
    """

    heading: Annotated[Interval, "1/s", 1e-9, 1e3, "lambda of the sliding surfaces"] = 0.8
    damping: Annotated[Interval, "1/s", 0.0, 1e3, "rate at which the distance to the surface decays"] = 2.0
    model: Annotated[Interval, "1/s", 0.0, 1e3, "natural frequency of the reference model of the heading"] = 2.0
    turn: Annotated[Interval, "1/s", 0.0, 1e3, "largest turn rate of the reference model [rad/s]"] = 0.5
    speed: Annotated[Interval, "1/s", 0.0, 1e3, "natural frequency of the speed autopilot"] = 0.5
    depth: Annotated[Interval, "1/s", 0.0, 1e3, "rate at which an error of the depth decays"] = 0.2
    name: ClassVar[str]

    class Constants(NamedTuple):
        """Its numbers in an episode, with those of the fins."""

        heading: Number = 0.0
        damping: Number = 0.0
        model: Number = 0.0
        turn: Number = 0.0
        speed: Number = 0.0
        depth: Number = 0.0
        fin_r: Number = 0.0  # [kg] see `Actuators.fin`
        fin_q: Number = 0.0

    class Memory(NamedTuple):
        """The last measurements and the states of the autopilots."""

        psi: Number
        psi_R: Number  # [rad] continuous in time with psi
        u: Number
        u_R: Number
        r: Number
        z: Number
        z_R: Number
        theta: Number
        theta_R: Number
        q: Number
        psi_d: Number  # [rad] heading, rate and acceleration of the reference model
        r_d: Number
        a_d: Number
        u_d: Number  # [m/s] filtered speed setpoint
        I_u: Number  # [m] integrals of the errors
        I_r: Number  # [rad s]
        I_z: Number  # [m s]
        I_q: Number  # [rad s]

    @classmethod
    def constants(cls, scenario: Any, episode: Any) -> tuple[Number, ...]:
        """Return the numbers of an episode."""
        act = scenario.actuators
        fin_q, fin_r = scenario.vertical.fins(act) if scenario.vertical else (0.0, act.fin)
        return *super().constants(scenario, episode)[: len(cls.entries)], fin_r, fin_q

    @staticmethod
    def measured(measured: Any, memory: Memory, at: At) -> tuple[Any, Memory]:
        """Remember the measurements; at the start the reference models begin there."""
        seen = dict(zip(at.names, measured, strict=True))
        now = memory._replace(**{name: seen[name] for name in ("psi", "u", "r", "z", "theta", "q") if name in seen})
        return measured, now._replace(psi_d=now.psi, u_d=now.u) if at.begins else now

    @staticmethod
    def errors(errors: Any, memory: Memory, at: At) -> tuple[Any, Memory]:
        """Remember the reference, which is the measurement less its error."""
        e = dict(zip(at.names, errors, strict=True))
        m = memory._replace(psi_R=memory.psi - e["psi"], u_R=memory.u - e["u"])
        if "theta" in e:
            c, s = at.ns.cos(m.theta), at.ns.sin(m.theta)  # errors of the position are along the body axes
            m = m._replace(theta_R=m.theta - e["theta"], z_R=m.z - (c * e["z"] - s * e["x"]))
        return errors, m

    @staticmethod
    def command(command: Force, memory: Memory, at: At) -> tuple[tuple[Number, ...], Memory]:
        """Return the shares of the limits that the autopilots command for the setpoints."""
        on, actions = at.own.heading > 0.0, dict(zip(at.channels, command, strict=True))
        level, limits = getattr(at.vehicle, "level", at.vehicle), dict(zip(at.channels, at.limits, strict=True))
        F_u, m = _surge(actions["u"], memory, at, level, limits["u"])
        F_r, m = _heading(actions["r"], m, at, level, limits["r"])
        shares = {"u": F_u, "r": F_r}
        if "q" in actions:
            shares["q"], m = _depth(actions["q"], m, at, limits["q"])
        return tuple(at.ns.where(on, shares[name], actions[name]) for name in at.channels), m
