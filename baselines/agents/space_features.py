"""Features of a network in space, as `baselines.agents.features` in the plane."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.scenarios.vehicles import PAPER
from auv_gym.task.model import Model
from auv_gym.task.preview import checked_preview
from auv_gym.task.space import SPACE, Observation, in_body_frame, in_world
from baselines.agents import space_filters
from baselines.agents.features import FAST, LARGEST_FEATURE, SLOW, Feature, fine
from baselines.agents.space_filters import FilterOutput, MeasuredNoise, estimated_errors
from baselines.space.backstepping import squared, wanted

_LARGEST_ERROR = 4.0  # largest position error that is integrated, in units of U * 1 s
_AXES, _CHANNELS = "xyz", "uqr"
INTEGRALS = 6
"""Number of rows of the integrals' memory: two integrals in units of U * 1 s, each with x, y and z in the world."""


def _each(names: Iterable[str], unit: str, scale: str, meaning: str) -> tuple[Feature, ...]:
    return tuple(Feature(name, unit, scale, meaning) for name in names)


_ERRORS = (
    *_each((f"e_{a}" for a in _AXES), "m", "U * 1 s", "measured position error along a body axis"),
    *_each(("theta_e", "psi_e"), "rad", "0.5 rad", "measured error of the axis"),
    *_each(("u_e", "v_e", "w_e"), "m/s", "0.5 U", "measured velocity error, over ground"),
    *_each(("q_e", "r_e"), "rad/s", "0.125 rad/s", "measured error of a turn rate"),
)
_OTHERS = (
    *_each(("theta_R",), "rad", "0.5 rad", "reference pitch"),
    *_each(("sin_theta",), "1", "1", "sine of the measured pitch"),
    *_each(("u_R",), "m/s", "1 m/s", "reference surge velocity"),
    *_each(("v_R", "w_R"), "m/s", "0.25 U", "reference velocity across the axis"),
    *_each(("q_R", "r_R"), "rad/s", "0.125 rad/s", "reference turn rate"),
    *_each((f"F_{c}R" for c in _CHANNELS), "N, N m", "the limit", "reference force or moment"),
    *_each((f"base_{c}" for c in _CHANNELS), "1", "1", "the expert's action"),
    *_each((f"fast_{a}" for a in _AXES), "m s", "U * 4 s^2", "integral of the position error, decay rate FAST"),
    *_each((f"slow_{a}" for a in _AXES), "m s", "U * 10 s^2", "the same with the decay rate SLOW"),
    *_each((f"c_{c}" for c in _CHANNELS), "1", "1", "previous correction"),
    *_each((f"a_{c}" for c in _CHANNELS), "1", "1", "previous command"),
    *_each(("F_u_max",), "N", "256 N", "surge force that action 1 commands"),
    *_each(("F_q_max", "F_r_max"), "N m", "128 N m", "moment that action 1 commands"),
    *_each(("depth",), "m", "d / (d + 5 m)", "measured depth, by which waves decay"),
    *_each(("dt",), "s", "0.125 s", "control period"),
)
_FINE = (
    *_each((f"e_{a}8" for a in _AXES), "m", "U * 0.125 s", "position error on a finer scale"),
    *_each((f"e_{a}8_m" for a in _AXES), "m", "0.0625 m", "position error on a fixed scale"),
    *_each((f"{f.name}_fine" for f in _ERRORS), "1", "fine", "an error, see `baselines.agents.features.fine`"),
)
LOADS: tuple[str, ...] = tuple(name for name in space_filters.MEMORY_ENTRIES if name[0] in "XYZMN")
"""Entries of a filter's estimate that are loads on the vehicle."""
_LIMITS = {"X": "F_u", "Y": "F_u", "Z": "F_u", "M": "F_q", "N": "F_r"}  # the limit by which a load is scaled


def _filter_features(prefix: str, sea: str) -> Iterable[Feature]:
    """Return the features of one filter."""
    what = f"filter for a {sea} sea: "
    for f in (*_FINE, *_ERRORS[3:8]):
        yield f._replace(name=prefix + f.name, meaning=what + f.meaning.removeprefix("measured "))
    yield from _each((f"{prefix}V_{a}" for a in _AXES), "m/s", "0.25 U", f"{what}current along a body axis")
    yield from _each((f"{prefix}F_{c}" for c in _CHANNELS), "N, N m", "the limit", f"{what}force of an actuator")
    for name in LOADS:
        unit = "N" if name[0] in "XYZ" else "N m"
        yield Feature(prefix + name, unit, f"0.0625 {_LIMITS[name[0]]}_max", f"{what}load {name}")


_FILTERED = (
    Feature("held", "1", "1", "1 where there is no new position fix"),
    *_each((f"noise_{name}" for name in MeasuredNoise._fields), "1", "log(x) / 4", "squared level of the noise"),
    *_filter_features("rough_", "rough"),
    *_filter_features("calm_", "calm"),
)


@dataclass(frozen=True)
class SpaceInputs:
    """The features of a network in space.

    Raises:
        ValueError: see `auv_gym.task.preview.checked_preview`; or `fine` is not a bool.
    """

    model: ClassVar[Model] = SPACE
    nominal_vehicle: ClassVar[bool] = False
    preview: tuple[int, ...] = ()  # control periods ahead
    fine: bool = False  # include the errors on finer scales
    filters: bool = False  # include the estimates of `space_filters.filter_step`

    def __post_init__(self) -> None:
        object.__setattr__(self, "preview", checked_preview(self.preview))
        for name in ("fine", "filters"):
            if not isinstance(value := getattr(self, name), bool):
                raise ValueError(f"{name} is {value!r}; it must be true or false")

    @property
    def memory(self) -> int:
        """Number of rows of the memory."""
        return INTEGRALS + (space_filters.ROWS if self.filters else 0)

    @property
    def constants(self) -> range:
        """Rows of the memory that count as constants in derivatives."""
        return range(INTEGRALS, INTEGRALS + (space_filters.CONSTANT if self.filters else 0))

    @property
    def features(self) -> tuple[Feature, ...]:
        """The features, one for each row of `update`."""
        ahead = (
            feature
            for n in self.preview
            for feature in _each((f"ahead_{n}_{a}" for a in _AXES), "m", f"0.25 U * {n} dt", "the reference ahead")
        )
        return (*_ERRORS, *_OTHERS, *ahead, *(_FINE if self.fine else ()), *(_FILTERED if self.filters else ()))

    def update(
        self,
        o: Sequence[Number],
        ahead: Sequence[Number],
        base: Iterable[Number],
        correction: Iterable[Number],
        memory: Iterable[Number],
        ns: Namespace,
        coefficients: Sequence[Number] = PAPER.in_space.all_coefficients,
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Return the features, one row for each, and the new memory; arguments as `Inputs.update`, in space."""
        seen, before = Observation._make(o), tuple(memory)
        sums, rest = before[:INTEGRALS], before[INTEGRALS:]
        U = ns.sqrt(squared(wanted(seen), ns))
        per_U = 1 / U
        e = tuple(x * per_U for x in o[:3])
        large = in_world([ns.clip(x, -_LARGEST_ERROR, _LARGEST_ERROR) for x in e], seen)
        fast, slow = (
            tuple(s + seen.dt * (x - rate * s) for s, x in zip(past, large, strict=True))
            for past, rate in ((sums[:3], FAST), (sums[3:], SLOW))
        )
        limits = seen.F_u_max, seen.F_q_max, seen.F_r_max
        forces = zip((seen.F_uR, seen.F_qR, seen.F_rR), limits, strict=True)
        velocities, angles, rates = o[5:8], o[3:5], o[8:10]
        depth = ns.clip(seen.depth, 0.0, 1e3)
        rows = [
            *e, *(2 * x for x in angles), *(2 * x * per_U for x in velocities), *(8 * x for x in rates),
            2 * seen.theta_R, seen.sin_theta, seen.u_R, 4 * seen.v_R * per_U, 4 * seen.w_R * per_U, 8 * seen.q_R,
            8 * seen.r_R, *(F / most for F, most in forces), *base,
            *(0.25 * x for x in in_body_frame(fast, seen)), *(0.1 * x for x in in_body_frame(slow, seen)),
            *correction, seen.a_u, seen.a_q, seen.a_r, limits[0] / 256, limits[1] / 128, limits[2] / 128,
            depth / (depth + 5.0), 8 * seen.dt,
        ]  # fmt: skip
        for k, periods in enumerate(self.preview):
            x, y, z = ahead[3 * k : 3 * k + 3]
            scale = per_U / (periods * seen.dt)
            rows += [4 * (x * scale - 1), 4 * y * scale, 4 * z * scale]
        if self.fine:
            rows += _fine(o[:3], angles, velocities, rates, per_U, ns)
        if self.filters:
            output, rest = space_filters.filter_step(seen, U, rest, ns, coefficients)
            rows += _filter_rows(output, seen, per_U, ns)
        return tuple(ns.clip(row, -LARGEST_FEATURE, LARGEST_FEATURE) for row in rows), (*fast, *slow, *rest)


def _fine(
    position: Sequence[Number],
    angles: Sequence[Number],
    velocities: Sequence[Number],
    rates: Sequence[Number],
    per_U: Number,
    ns: Namespace,
) -> list[Number]:
    """Return the rows of `_FINE` for tracking errors in SI units."""
    e, relative = [x * per_U for x in position], (x * per_U for x in velocities)
    return [*(8 * x for x in e), *(16 * x for x in position), *(fine(x, ns) for x in (*e, *angles, *relative, *rates))]


def _filter_rows(output: FilterOutput, o: Observation, per_U: Number, ns: Namespace) -> list[Number]:
    """Return the rows of `_FILTERED`."""
    rows = [output.held, *(0.25 * ns.log(ns.clip(level, 1e-4, 1e4)) for level in output.levels)]
    limits = {"F_u": o.F_u_max, "F_q": o.F_q_max, "F_r": o.F_r_max}
    for z in output.estimates:
        e, angles, velocities, rates = estimated_errors(z, output, o, ns)
        current = in_body_frame((z.V_x, z.V_y, z.V_z), o)
        rows += [
            *_fine(e, angles, velocities, rates, per_U, ns),
            *(2 * x for x in angles), *(2 * x * per_U for x in velocities), *(4 * V * per_U for V in current),
            *(getattr(z, name) / most for name, most in limits.items()),
            *(16 * getattr(z, name) / limits[_LIMITS[name[0]]] for name in LOADS),
        ]  # fmt: skip
    return rows
