"""Tables of published vehicles and of tuned gains, for docs/vehicles.md and docs/policies.md."""

from __future__ import annotations

from auv_gym.scenarios.names import SPEED_RANGES
from auv_gym.scenarios.vehicles import PAPER, PAPER_LAG, VehicleModel, vehicle_model, vehicle_names
from baselines.gains.loading import GAINS_FOLDER
from baselines.tools.files import read_json
from baselines.tuning.tunables import TUNABLES
from research.pages import table

_HEADS = (
    "name", "what", "L [m]", "speed [m/s]", "thrust [N]", "yaw moment at that speed [N m]", "lag [s]", "m22/m11",
    "sway drag", "yaw drag", "yaw moment / (m11 U^2)",
)  # fmt: skip


def published_vehicles() -> str:
    """Return the vehicles with their numbers and the sources of these, as two tables in Markdown."""
    every = [PAPER, *map(vehicle_model, vehicle_names())]
    sources = [(f"`{c.name}`", c.source, c.left_out, c.assumed) for c in every[1:]]
    numbers = table(_HEADS, map(_row, every), right=False)
    return f"{numbers}\n\n{table(('name', 'source', 'left out', 'assumed'), sources, right=False)}"


def _row(c: VehicleModel) -> tuple[str, ...]:
    v, act, U = c.vehicle, c.actuators, c.vehicle.speed
    torque = min(act.F_r_max, act.fin * U * U) if act.fin else act.F_r_max
    lag = PAPER_LAG * v.time / PAPER.vehicle.time if c.lag is None else c.lag
    _, sway, yaw = c.drag(U)
    numbers = v.length, U, act.F_u_max, torque, lag, v.m22 / v.m11, sway / v.m22, yaw / v.m33, torque / v.m11 / U**2
    return f"`{c.name}`", c.about, *(f"{number:.3g}" for number in numbers)


def tuned_gains() -> str:
    """Return what each controller's tuned gains gave on the validation episodes, as a table in Markdown."""
    rows = []
    for name in TUNABLES:
        for speed_range in SPEED_RANGES:
            record = read_json(GAINS_FOLDER / f"{name}-{speed_range}.json")
            v = record["validation"]
            errors = f"{1e3 * v['error_m']:.3g}", f"{v['score']:.3f}", f"{100 * v['failed']:.1f} %"
            ratios = f"{v['effort_ratio']:.2f}", f"{v['smoothness_ratio']:.1f}"
            rows.append((f"`{name}`", speed_range, len(record["gains"]), *errors, *ratios))
    heads = "controller", "speed range", "gains", "error [mm]", "error reduction", "failures", "effort", "command rate"
    return table(heads, rows)
