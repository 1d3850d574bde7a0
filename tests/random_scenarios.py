"""Random scenarios of the whole schema, for hypothesis.

Every field of every part takes random values: vehicle, path, disturbances, sensors, actuators, start, clock, reward.
"""

from __future__ import annotations

import math
from dataclasses import replace

from hypothesis import reject
from hypothesis import strategies as st

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.faults import FAULT_KINDS, RandomFaults
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.effects.navigation import RandomReckoning
from auv_gym.effects.sensors import Sensors
from auv_gym.effects.waves import RandomWaves
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.planning.paths import PATHS, Path, Spline
from auv_gym.scenarios.fitting import adapted
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start
from auv_gym.scenarios.vehicles import vehicle_model, vehicle_names

SUBSTEPS = (1, 2, 4)
DRAWN = [name for name, family in PATHS.items() if hasattr(family, "drawn")]
"""The families of paths that have random members."""


class Shrinking:
    """Random choices of hypothesis."""

    def __init__(self, draw):
        self._draw = draw

    def number(self, low, high):
        """Return a float of an interval."""
        return self._draw(st.floats(low, high, allow_subnormal=False))

    def of(self, options):
        """Return one of several."""
        return self._draw(st.sampled_from(options))


def interval(choose, low, high):
    """Return a number, or a pair of them in their order."""
    if choose.of((False, True)):
        return choose.number(low, high)
    first, second = sorted((choose.number(low, high), choose.number(low, high)))
    return first, second


def either(choose, make):
    """Return what a function makes, or None."""
    return choose.of((lambda: None, make))()


def some(choose, intervals=(), **numbers):
    """Return some of the entries between their bounds, by name, as intervals or numbers; others keep their defaults."""
    fields = {name: interval(choose, *bounds) for name, bounds in dict(intervals).items() if choose.of((False, True))}
    return fields | {name: choose.number(*bounds) for name, bounds in numbers.items() if choose.of((False, True))}


def vehicle(choose):
    """Return a vehicle up to three times lighter, heavier, or with less or more drag than the paper's."""

    def times(low=1 / 3, high=3.0):
        return math.exp(choose.number(math.log(low), math.log(high)))

    p = PAPER_VEHICLE
    m11 = p.m11 * times()
    m22 = m11 * choose.number(1.05, 2.5)
    drag = {name: getattr(p, name) * times() for name in ("d11", "d22", "d33")}
    quadratic = {"X_uu": (0, 200), "Y_vv": (0, 400), "N_rr": (0, 200)}
    lift = {"Y_uv": (0, 100), "Y_ur": (-0.5, 1), "N_uv": (-30, 60), "N_ur": (0, 100)}
    more = some(choose, **quadratic, **lift, speed=(0.5, 3))
    if "Y_ur" in more:
        more["Y_ur"] *= m22 / 1.02 - m11  # so that m22 stays above m11 - Y_ur
    return Vehicle(m11, m22, p.m33 * times(), **drag, **more)


def path(choose):
    """Return the distribution of a path, or a path at another place."""
    speed, turn_rate = interval(choose, 0.1, 1.5), choose.number(0.01, 0.15)
    kind = choose.of(("drawn", "fixed", "spline"))
    if kind == "drawn":
        families = tuple(choose.of(DRAWN) for _ in range(choose.of((1, 2, 3))))
        return RandomPath(speed, turn_rate, families)
    fast = speed if isinstance(speed, float) else speed[1]
    if kind == "fixed":
        made = PATHS[choose.of(DRAWN)].drawn(fast, turn_rate, lambda: choose.number(0, 0.999))
        place = {name: choose.number(-100, 100) for name in ("x0", "y0")}
        return replace(made, **place, heading=choose.number(-7, 7))
    points, course = [(choose.number(-50, 50), choose.number(-50, 50))], choose.number(-math.pi, math.pi)
    for _ in range(choose.of((2, 4, 8))):
        x, y = points[-1]
        course += choose.number(-0.5, 0.5)
        points.append((x + 30 * math.cos(course), y + 30 * math.sin(course)))
    speeds = either(choose, lambda: tuple(fast * choose.number(0.8, 1.2) for _ in points))
    return Spline(tuple(points), fast, speeds or ())


def current(choose):
    """Return the distribution of a current."""
    waters = {"speed": (0, 0.5), "direction": (-4, 4), "turn": (-0.1, 0.1), "shear": (0, 0.3), "wavelength": (5, 200)}
    fields = some(choose, waters, gust=(0, 0.2), gust_time=(0.5, 60), smoothing=(0, 10), cap=(0, 1))
    return RandomCurrent(**fields, relative=choose.of((True, False)))


def waves(choose):
    """Return the distribution of waves."""
    forces = {name: choose.number(0, 0.4) for name in ("surge", "sway", "yaw")}
    low, high = sorted((choose.number(0.1, 4), choose.number(0.1, 4)))
    return RandomWaves(**forces, band=(low, high), components=choose.of((1, 2, 6, 12)))


def mismatch(choose, known):
    """Return the distribution of the true vehicle about a known one."""
    least = 1.02 * known.m11 / known.m22
    intervals = dict.fromkeys(("mass", "m33", "d11", "d22", "d33"), (0.7, 1.4))
    intervals |= {"ratio": (max(0.9, least), max(1.2, least + 0.1)), "quadratic": (0, 1)}
    drag = tuple(choose.number(0, 300) for _ in range(3))
    return RandomMismatch(**some(choose, intervals), quadratic_drag=choose.of(((100.0, 200.0, 100.0), drag)))


def sensors(choose):
    """Return the sensors' errors."""
    noise = {"position": (0, 1), "heading": (0, 0.1), "velocity": (0, 0.1), "yaw_rate": (0, 0.05)}
    intervals = {f"{name}_bias": (-high, high) for name, (_, high) in noise.items()} | {"outage_time": (0, 10)}
    fields = some(choose, intervals, **noise, outages=(0, 60), low_pass=(0.05, 10))
    levels = {name: interval(choose, 1e-4, high) for name, (_, high) in noise.items() if choose.of((False, True))}
    if choose.of((False, True)):
        return Sensors(**fields | levels, correlation=interval(choose, 0, 5))
    return Sensors(**fields | levels, reckoning=either(choose, lambda: reckoning(choose)))


def reckoning(choose):
    """Return the distribution of a dead reckoning."""
    intervals = {"interval": (1, 20), "scale": (-0.1, 0.1), "misalignment": (-0.2, 0.2), "drift": (-0.01, 0.01)}
    return RandomReckoning(**some(choose, intervals, walk=(0, 0.01)))


def actuators(choose):
    """Return the actuators."""
    intervals = {"lag": (0, 2), "effectiveness": (0.5, 1), "reach": (0.5, 1), "delay": (0, 3)}
    fields = some(choose, intervals, F_u_rate=(10, 1000), F_r_rate=(10, 1000), fin=(0, 500), astern=(0, 1))
    return Actuators(choose.number(60, 2000), choose.number(30, 1000), **fields)


def start(choose):
    """Return the distribution of the first state."""
    fields = some(choose, {"x_e": (-5, 5), "y_e": (-5, 5), "psi_e": (-3, 3), "surge": (-1, 2)})
    return Start(**fields, random_signs=choose.of((False, True)))


def faults(choose):
    """Return the distribution of faults."""
    kinds = tuple(choose.of(FAULT_KINDS) for _ in range(choose.of((1, 2, 3))))
    numbers = choose.number(0, 60), interval(choose, 0, 2), interval(choose, 0, 5), interval(choose, 0, 0.5)
    return RandomFaults(kinds, *numbers, either(choose, lambda: interval(choose, 0, 5)))


def scenario(choose, substeps=SUBSTEPS):
    """Return a scenario; whether its path can be followed is not known.

    Raises:
        ValueError: the parts do not fit together.
    """
    known = either(choose, lambda: vehicle(choose)) or PAPER_VEHICLE
    parts = {
        "path": path(choose),
        "vehicle": known,
        "mismatch": either(choose, lambda: mismatch(choose, known)),
        "current": either(choose, lambda: current(choose)),
        "waves": either(choose, lambda: waves(choose)),
        "sensors": sensors(choose),
        "actuators": actuators(choose),
        "start": start(choose),
        "faults": either(choose, lambda: faults(choose)),
        "steps": choose.of((1, 2, 7, 30)),
        "substeps": choose.of(substeps),
        "error_scale": choose.number(0.1, 2),
        "rate_weight": choose.number(0, 1),
        "lost_distance": choose.number(3, 500),
    }
    control_dt = choose.number(0.02, 0.3)
    while True:
        try:
            made = Scenario("random", control_dt=control_dt, **parts)
            break
        except ValueError:
            if control_dt < 5e-3:
                raise
            control_dt /= 2  # an integration step may be too long
    if isinstance(made.path, Path) or choose.of((True, True, False)):
        return made
    return replace(adapted(vehicle_model(choose.of(vehicle_names())), made), substeps=made.substeps)


@st.composite
def scenarios(draw, substeps=SUBSTEPS):
    """Return what `scenario` does, as a strategy; what is refused is drawn again."""
    try:
        return scenario(Shrinking(draw), substeps)
    except ValueError:
        return reject()
