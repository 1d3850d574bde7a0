"""Features of a network: a scaled observation, the expert's action, integrals of the error and estimates.

The equations accept NumPy rows and torch tensors. Lengths are in units of the distance that the reference covers in a
second, and forces in units of the actuators' limits. One network can thus learn every speed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Namespace, Number, wrap_angle
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients
from auv_gym.task.model import PLANE, Model
from auv_gym.task.observation import Observation
from auv_gym.task.preview import checked_preview
from baselines.agents import filters
from baselines.estimation.sea_model import measurement
from baselines.policy import reference_speed

LARGEST_FEATURE = 8.0
"""Largest magnitude of a feature."""
FAST = 0.1  # [1/s] decay rate of the fast integral of the position error
SLOW = 0.015  # [1/s] decay rate of the slow integral of the position error
_LARGEST_ERROR = 4.0
"""Largest position error that is integrated, in units of U * 1 s; it limits the integrator windup."""


class Feature(NamedTuple):
    """One input of a network: the quantity divided by `scale`, clipped to +-`LARGEST_FEATURE`."""

    name: str
    unit: str
    scale: str  # U: the reference's speed, at least `policy.SPEED_FLOOR`; F_u_max, F_r_max: the actuators' limits
    meaning: str


FEATURES = (  # standard inputs of a network, in their order
    Feature("e_x", "m", "U * 1 s", "measured position error along the body's surge axis"),
    Feature("e_y", "m", "U * 1 s", "the same along the sway axis"),
    Feature("psi_e", "rad", "0.5 rad", "measured heading error"),
    Feature("u_e", "m/s", "0.5 U", "measured surge velocity error, over ground"),
    Feature("v_e", "m/s", "0.5 U", "measured sway velocity error, over ground"),
    Feature("r_e", "rad/s", "0.125 rad/s", "measured yaw rate error"),
    Feature("u_R", "m/s", "1 m/s", "reference surge velocity"),
    Feature("v_R", "m/s", "0.25 U", "reference sway velocity"),
    Feature("r_R", "rad/s", "0.125 rad/s", "reference yaw rate"),
    Feature("F_uR", "N", "F_u_max", "reference surge force"),
    Feature("F_rR", "N m", "F_r_max", "reference yaw torque"),
    Feature("base_u", "1", "1", "the expert's action, surge"),
    Feature("base_r", "1", "1", "the expert's action, yaw"),
    Feature("fast_x", "m s", "U * 4 s^2", "integral of the position error in the world, decay rate FAST, surge axis"),
    Feature("fast_y", "m s", "U * 4 s^2", "the same along the sway axis"),
    Feature("slow_x", "m s", "U * 10 s^2", "the same integral with the decay rate SLOW, surge axis"),
    Feature("slow_y", "m s", "U * 10 s^2", "the same along the sway axis"),
    Feature("c_u", "1", "1", "previous correction, surge, in [-1, 1]"),
    Feature("c_r", "1", "1", "previous correction, yaw"),
    Feature("a_u", "1", "1", "previous command, surge"),
    Feature("a_r", "1", "1", "previous command, yaw"),
    Feature("F_u_max", "N", "256 N", "surge force that action 1 commands"),
    Feature("F_r_max", "N m", "128 N m", "yaw torque that action 1 commands"),
    Feature("dt", "s", "0.125 s", "control period"),
)
_SUMS = slice(13, 17)  # the integrals among them
ERROR_FEATURES = 6
"""Number of features that are tracking errors; they come first."""
INTEGRALS = 4
"""Number of rows of the integrals' memory: two integrals in units of U * 1 s, each with x and y in the world."""


_FINE = 100.0
"""Ratio of the slope of `fine` at zero to its slope for large values, about."""
LOADS = tuple(name for name in filters.MEMORY_ENTRIES if name[0] in "XYN" and name not in ("x_e", "y_e"))
"""Entries of a filter's estimate that are loads on the vehicle."""


def scaled_errors(o: Sequence[Number], ns: Namespace) -> tuple[Any, ...]:
    """Return the first `ERROR_FEATURES` features before they are clipped."""
    e_x, e_y, psi_e, u_e, v_e, r_e, u_R, v_R = o[:8]
    per_U = 1 / reference_speed(u_R, v_R, ns)
    return e_x * per_U, e_y * per_U, 2 * psi_e, 2 * u_e * per_U, 2 * v_e * per_U, 8 * r_e


@dataclass(frozen=True)
class Inputs:
    """The features of a network: `FEATURES`, then those of the preview and of the options.

    Raises:
        ValueError: see `auv_gym.task.preview.checked_preview`; or another entry is not a bool.
    """

    model: ClassVar[Model] = PLANE
    preview: tuple[int, ...] = ()  # control periods ahead
    integrals: bool = True  # include the integrals of the position error
    fine: bool = False  # include the errors on finer scales
    filters: bool = False  # include the estimates of `filters.filter_step`
    nominal_vehicle: bool = False  # include the nominal vehicle, and use it as model of the filters

    def __post_init__(self) -> None:
        object.__setattr__(self, "preview", checked_preview(self.preview))
        for name in ("integrals", "fine", "filters", "nominal_vehicle"):
            if not isinstance(value := getattr(self, name), bool):
                raise ValueError(f"{name} is {value!r}; it must be true or false")

    @property
    def features(self) -> tuple[Feature, ...]:
        """The features, one for each row of `update`."""
        features = FEATURES if self.integrals else FEATURES[: _SUMS.start] + FEATURES[_SUMS.stop :]
        features += tuple(feature for periods in self.preview for feature in _preview_features(periods))
        features += FINE_FEATURES if self.fine else ()
        features += FILTER_FEATURES if self.filters else ()
        return features + (VEHICLE_FEATURES if self.nominal_vehicle else ())

    @property
    def memory(self) -> int:
        """Number of rows of the memory."""
        return INTEGRALS + (filters.ROWS if self.filters else 0)

    @property
    def constants(self) -> range:
        """Rows of the memory that count as constants in derivatives."""
        return range(INTEGRALS, INTEGRALS + (filters.CONSTANT if self.filters else 0))

    def update(
        self,
        o: Sequence[Number],
        ahead: Sequence[Number],
        base: Iterable[Number],
        correction: Iterable[Number],
        memory: Iterable[Number],
        ns: Namespace,
        coefficients: Coefficients = PAPER_VEHICLE.coefficients,
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Return the features, one row for each, and the new memory.

        Args:
            o: the terms of an observation in SI units, see `auv_gym.task.observation.TERMS`.
            ahead: the columns of the preview [m], two for each of its times, see `auv_gym.task.preview.Preview`.
            base: the expert's action at this instant, surge and yaw.
            correction: the previous output of the network, surge and yaw; zero at the start of an episode.
            memory: `Inputs.memory` rows from the previous call; zero at the start of an episode.
            ns: the namespace of the numbers.
            coefficients: `Vehicle.all_coefficients` of the nominal vehicle in the paper's units
                (`auv_gym.physics.units`); not used without `Inputs.nominal_vehicle`.
        """
        u_R, v_R, r_R, F_uR, F_rR, c, s, F_u_max, F_r_max, a_u, a_r, dt = o[6:18]
        (x1, y1, x2, y2), rest = (before := tuple(memory))[:INTEGRALS], before[INTEGRALS:]
        errors = scaled_errors(o, ns)
        x, y = (ns.clip(e, -_LARGEST_ERROR, _LARGEST_ERROR) for e in errors[:2])
        x, y = to_world(x, y, c, s)
        x1, y1 = x1 + dt * (x - FAST * x1), y1 + dt * (y - FAST * y1)
        x2, y2 = x2 + dt * (x - SLOW * x2), y2 + dt * (y - SLOW * y2)
        fast_x, fast_y = to_body(x1, y1, c, s)
        slow_x, slow_y = to_body(x2, y2, c, s)
        per_U = 1 / reference_speed(u_R, v_R, ns)
        sums = (0.25 * fast_x, 0.25 * fast_y, 0.1 * slow_x, 0.1 * slow_y) if self.integrals else ()
        scales = (per_U / (periods * dt) for periods in self.preview)
        later = zip(scales, ahead[::2], ahead[1::2], strict=True)
        rows = (
            *errors, u_R, 4 * v_R * per_U, 8 * r_R, F_uR / F_u_max, F_rR / F_r_max, *base, *sums,
            *correction, a_u, a_r, F_u_max / 256, F_r_max / 128, 8 * dt,
            *(row for k, X, Y in later for row in (4 * (X * k - 1), 4 * Y * k)),
        )  # fmt: skip
        if self.fine:
            rows += _fine(o[:ERROR_FEATURES], per_U, ns)
        if self.filters:
            model = coefficients if self.nominal_vehicle else _PAPER
            output, rest = filters.filter_step(Observation._make(o), 1 / per_U, rest, ns, model)
            rows += _filter_rows(output, Observation._make(o), per_U, ns)
        if self.nominal_vehicle:
            rows += _vehicle_rows(coefficients)
        return tuple(ns.clip(row, -LARGEST_FEATURE, LARGEST_FEATURE) for row in rows), (x1, y1, x2, y2, *rest)


STANDARD = Inputs()
"""Default inputs of a network."""


def fine(x: Number, ns: Namespace) -> Number:
    """Return 50 x / sqrt(1 + 100 |x|): the slope is 50 at zero; the value is 5 at x = 1 and 16 at x = 10."""
    return 0.5 * _FINE * x / ns.sqrt(1 + _FINE * abs(x))


def _fine(errors: Sequence[Number], per_U: Number, ns: Namespace) -> tuple[Number, ...]:
    """Return the rows of `FINE_FEATURES` for e_x, e_y [m], psi_e [rad], u_e, v_e [m/s], r_e [rad/s]."""
    e_x, e_y, psi_e, u_e, v_e, r_e = errors
    scaled = e_x * per_U, e_y * per_U, psi_e, u_e * per_U, v_e * per_U, r_e
    return (8 * scaled[0], 8 * scaled[1], 16 * e_x, 16 * e_y, *(fine(x, ns) for x in scaled))


def _filter_rows(output: filters.FilterOutput, o: Observation, per_U: Number, ns: Namespace) -> tuple[Number, ...]:
    """Return the rows of `FILTER_FEATURES`."""
    levels = (0.25 * ns.log(ns.clip(level, 1e-4, 1e4)) for level in output.levels)
    rows: tuple[Number, ...] = (
        ns.where(output.held, 1.0, 0.0), ns.where(output.velocity_held, 1.0, 0.0), *levels,
        *(4 * b * per_U for b in output.bias),
    )  # fmt: skip
    limits = {"X": o.F_u_max, "Y": o.F_u_max, "N": o.F_r_max}
    psi_R = ns.arctan2(o.sin_psi, o.cos_psi) - o.psi_e
    for z in output.estimates:
        e_x, e_y = to_body(z.x_e, z.y_e, o.cos_psi, o.sin_psi)
        _, _, _, u, v, _ = measurement(z, ns)
        errors = e_x, e_y, wrap_angle(z.psi - psi_R, ns), u - o.u_R, v - o.v_R, z.r - o.r_R
        V_u, V_v = to_body(z.V_x, z.V_y, o.cos_psi, o.sin_psi)
        rows += (
            *_fine(errors, per_U, ns), 2 * errors[2], 2 * errors[3] * per_U, 2 * errors[4] * per_U,
            4 * V_u * per_U, 4 * V_v * per_U, z.F_u / o.F_u_max, z.F_r / o.F_r_max,
            *(16 * getattr(z, name) / limits[name[0]] for name in LOADS),
        )  # fmt: skip
    return rows


def _preview_features(periods: int) -> tuple[Feature, Feature]:
    """Return the features of one time of a preview."""
    what = f"displacement of the reference in the next {periods} control periods"
    scale = f"0.25 U * {periods} dt"
    return (
        Feature(f"ahead_{periods}_x", "m", scale, f"{what} along the surge axis, minus U * {periods} dt"),
        Feature(f"ahead_{periods}_y", "m", scale, f"{what} along the sway axis"),
    )


def _fine_features(prefix: str, what: str) -> tuple[Feature, ...]:
    """Return the features of the rows of `_fine`."""
    errors = {
        "e_x": ("m", " U * 1 s"), "e_y": ("m", " U * 1 s"), "psi_e": ("rad", " 1 rad"),
        "u_e": ("m/s", " U"), "v_e": ("m/s", " U"), "r_e": ("rad/s", " 1 rad/s"),
    }  # fmt: skip
    linear = (("", "U * 0.125 s"), ("_m", "0.0625 m"))
    return (
        *(Feature(f"{prefix}{e}8{m}", "m", scale, f"{what}: {e}") for m, scale in linear for e in ("e_x", "e_y")),
        *(
            Feature(f"{prefix}{e}_fine", u, f"fine{scale}", f"{what}: {e}, see `fine`")
            for e, (u, scale) in errors.items()
        ),
    )


def _filter_features(prefix: str, what: str) -> tuple[Feature, ...]:
    """Return the features of one filter."""
    return (
        *_fine_features(prefix, what),
        Feature(f"{prefix}psi_e", "rad", "0.5 rad", f"{what}: heading error"),
        Feature(f"{prefix}u_e", "m/s", "0.5 U", f"{what}: surge velocity error, over ground"),
        Feature(f"{prefix}v_e", "m/s", "0.5 U", f"{what}: sway velocity error, over ground"),
        Feature(f"{prefix}V_u", "m/s", "0.25 U", f"{what}: current along the surge axis"),
        Feature(f"{prefix}V_v", "m/s", "0.25 U", f"{what}: current along the sway axis"),
        Feature(f"{prefix}F_u", "N", "F_u_max", f"{what}: force of the surge actuator"),
        Feature(f"{prefix}F_r", "N m", "F_r_max", f"{what}: torque of the yaw actuator"),
        *(
            Feature(prefix + name, "N m" if name[0] == "N" else "N",
                    "0.0625 F_r_max" if name[0] == "N" else "0.0625 F_u_max", f"{what}: load {name}")
            for name in LOADS
        ),
    )  # fmt: skip


def _vehicle_rows(c: Coefficients) -> tuple[Number, ...]:
    """Return the rows of `VEHICLE_FEATURES`."""
    ratios = (
        c.d11 / c.m11, c.X_uu / c.m11, c.d22 / c.m22, c.Y_vv / c.m22, c.Y_uv / c.m22,
        c.d33 / c.m33, c.N_rr / c.m33, c.N_ur / c.m33,
    )  # fmt: skip
    scaled = (2 * x / (x + half) for x, half in zip(ratios, HALVES, strict=True))
    return (c.m22 / c.m11 - 1, *scaled, c.Y_ur / c.m22, c.N_uv / c.m33)


_PAPER = PAPER_VEHICLE.coefficients
HALVES = (0.1, 0.05, 0.4, 1.0, 0.5, 1.0, 4.0, 0.5)
"""Ratios of drag and lift to inertia at which the features are 1, in the order of `_vehicle_rows`: typical values."""
FINE_FEATURES = _fine_features("", "measured")
"""Additional features with `Inputs.fine`: the errors on finer scales."""
FILTER_FEATURES = (
    Feature("held", "1", "1", "1 where there is no new position fix"),
    Feature("velocity_held", "1", "1", "1 where there is no new measurement of the velocities"),
    *(
        Feature(f"noise_{name}", "1", "log(x) / 4", f"squared level of the noise: {name}")
        for name in filters.MeasuredNoise._fields
    ),
    Feature("b_u", "m/s", "0.25 U", "estimated bias of the measured surge velocity"),
    Feature("b_v", "m/s", "0.25 U", "estimated bias of the measured sway velocity"),
    *_filter_features("rough_", "filter for a rough sea"),
    *_filter_features("calm_", "filter for a calm sea"),
    *_filter_features("faulty_", "filter for faults of the sensors"),
)
"""Additional features with `Inputs.filters`."""
VEHICLE_FEATURES = (
    Feature("m22", "1", "1", "m22 / m11 - 1 of the known vehicle"),
    *(
        Feature(name, unit, f"x / (x + {half:g}) * 2", f"{name} / {inertia} of the known vehicle in the paper's units")
        for half, (name, inertia, unit) in zip(
            HALVES,
            (
                ("d11", "m11", "1/s"), ("X_uu", "m11", "1/m"), ("d22", "m22", "1/s"), ("Y_vv", "m22", "1/m"),
                ("Y_uv", "m22", "1/m"), ("d33", "m33", "1/s"), ("N_rr", "m33", "1"), ("N_ur", "m33", "1/m"),
            ),
            strict=True,
        )
    ),
    Feature("Y_ur", "1", "1", "Y_ur / m22 of the known vehicle"),
    Feature("N_uv", "1/m^2", "1 / m^2", "N_uv / m33 of the known vehicle in the paper's units"),
)  # fmt: skip
"""Additional features with `Inputs.nominal_vehicle`: ratios; x / (x + half) compresses the range of those of drag and
lift."""
