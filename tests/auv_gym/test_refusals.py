"""Wrong numbers in the parts of a scenario are refused, with the name of the field and its value."""

import math
from dataclasses import fields

import pytest

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.faults import RandomFaults
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.effects.navigation import RandomReckoning
from auv_gym.effects.sensors import Sensors
from auv_gym.effects.waves import RandomWaves
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start

NEEDED = {RandomFaults: {"kinds": ("yaw dead",)}, RandomPath: {"speed": 1.0, "turn_rate": 0.1}}
PARTS = Actuators, RandomCurrent, RandomFaults, RandomMismatch, RandomPath, RandomReckoning, RandomWaves
NUMBERS = [
    (part, field.name, field.type == "Interval")
    for part in (*PARTS, Scenario, Sensors, Start)
    for field in fields(part)
    if field.type in ("float", "Interval")
]


@pytest.mark.parametrize("value", [math.nan, -1e12, "1", True, None, 10**400], ids=str)
@pytest.mark.parametrize(("part", "name", "interval"), NUMBERS, ids=str)
def test_what_is_no_number_in_its_bounds_is_refused(part, name, interval, value):
    with pytest.raises(ValueError, match=rf"{name} is {value!r}; it must be a number in [\[(]"):
        part(**NEEDED.get(part, {}) | {name: value})
    if interval:
        with pytest.raises(ValueError, match=rf"{name} is \({value!r}, .*; it must be a number in .*, or a pair"):
            part(**NEEDED.get(part, {}) | {name: (value, value)})


@pytest.mark.parametrize(("part", "name"), [(part, name) for part, name, interval in NUMBERS if interval], ids=str)
def test_what_is_no_pair_is_refused(part, name):
    for value in ((0.1,), (0.1, 0.1, 0.1)):
        with pytest.raises(ValueError, match=rf"{name} is \(0.1,.*; it must be a number in .*, or a pair"):
            part(**NEEDED.get(part, {}) | {name: value})


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        (Actuators, {"F_u_max": 0}, r"actuators F_u_max is 0; it must be a number in \[0.001, 1e\+09\]"),
        (Actuators, {"effectiveness": 1.2}, "actuators effectiveness is 1.2"),
        (Actuators, {"lag": (0.5, 0.2)}, r"actuators lag is \(0.5, 0.2\); low must not be above high"),
        (Actuators, {"lag": math.inf}, "actuators lag is inf; it must be a number"),
        (Actuators, {"F_u_rate": 0.0}, "actuators F_u_rate is 0.0"),
        (Actuators, {"delay": 4}, "actuators delay is 4"),
        (Sensors, {"low_pass": 0.0}, "sensors low_pass is 0.0"),
        (Sensors, {"reckoning": 20}, "sensors reckoning is 20; it must be a RandomReckoning or None"),
        (RandomCurrent, {"relative": 1}, "current relative is 1; it must be true or false"),
        (RandomCurrent, {"wavelength": 0.0}, "current wavelength is 0.0"),
        (RandomWaves, {"band": 0.8}, r"waves band is 0.8; it must be a pair \(low, high\)"),
        (RandomWaves, {"band": (1.1, 0.5)}, "waves band is .* low must not be above high"),
        (RandomWaves, {"components": 13}, r"waves components is 13; it must be an integer in \[1, 12\]"),
        (RandomWaves, {"components": True}, "waves components is True"),
        (RandomMismatch, {"quadratic_drag": (1.0, 2.0)}, "mismatch quadratic_drag is .* three numbers"),
        (RandomFaults, {"kinds": ()}, r"faults kinds is \(\); it must be a tuple of some of: surge stuck"),
        (RandomFaults, {"kinds": ("rudder lost",)}, r"faults kinds is \('rudder lost',\); it must be"),
        (RandomReckoning, {"interval": 0.5}, r"reckoning interval is 0.5; it must be a number in \[1, 10000\]"),
        (Start, {"random_signs": 1}, "start random_signs is 1; it must be true or false"),
        (RandomPath, {"families": ("spiral",)}, "unknown path family 'spiral'"),
        (RandomPath, {"families": ()}, "path families is empty"),
        (RandomPath, {"families": "line"}, r"path families is 'line'; it must be a list, such as \['line'\]"),
        (
            Scenario,
            {"start": Start(x_e=(-30, -18), y_e=80)},
            "x_e, y_e are 82 m or more; raise lost_distance from 30 m",
        ),
        (Scenario, {"steps": 1.5}, "steps is 1.5; it must be an integer"),
        (Scenario, {"name": ""}, "scenario name is ''"),
        *((Scenario, {part: 3}, f"scenario {part} is 3; it must be a ") for part in ("path", "vehicle", "sensors")),
    ],
)
def test_wrong_values_are_refused(part, values, message):
    with pytest.raises(ValueError, match=message):
        part(**NEEDED.get(part, {}) | values)
