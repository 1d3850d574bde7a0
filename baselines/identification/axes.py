"""Contradictions in a log: positions, heading, velocities and commands with wrong units, signs or axes."""

from __future__ import annotations

import math

import numpy as np

from auv_gym.physics.namespaces import Array

_WINDOW = 5.0  # [s] over which changes of position are compared with integrals of velocities
_BETTER = 0.3  # largest ratio of unexplained shares with which another explanation is the better one
_ANGLE = math.radians(15)  # least angle between positions and heading that is a contradiction
_UNEXPLAINED = 0.5  # share of the displacements, without noise, from which nothing explains them
_CERTAIN = 4.0  # [standard deviations] from which a sign is certain
_RESPONSE = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # [s] windows in which a command may show its effect
_DEGREE = math.pi / 180
_SMALL = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # [s]


class ContradictionError(ValueError):
    """Columns of a log contradict each other; the message names the entry of a format that mends it."""


def check_motion(t: Array, measured: Array, noise: Array) -> None:
    """Compare the changes of position and heading with the integrals of the velocities.

    Positions are d = a integral of (u +- i v) exp(+-i psi) in the complex plane. The signs and the angle of a that
    explain them best show which columns have another sign or other axes.

    Args:
        t: time [s], shape (T,).
        measured: x, y, psi, u, v, r, shape (T, 6).
        noise: their standard deviations, roughly, shape (6,).

    Raises:
        ContradictionError: with the columns and the entry that mends them.
    """
    x, y, psi, u, v, r = measured.T
    dt = float(np.median(np.diff(t)))
    short, heading = max(1, round(1 / dt)), np.unwrap(psi)
    turned, wrapped, integrated = _change(heading, short), _change(psi, short), _integral(r, t, short)
    if integrated.std() > 0:
        if abs(_slope(integrated, wrapped) * _DEGREE - 1) < 0.3 and abs(_slope(integrated, turned) - 1) > 0.3:
            raise ContradictionError("psi changes 57 times as fast as r: it looks like degrees; it must be in [rad]")
        if abs(_slope(turned, integrated) * _DEGREE - 1) < 0.3:
            raise ContradictionError("r is 57 times the rate of psi: it looks like degrees; it must be in [rad/s]")
    size = math.sqrt(float(integrated @ integrated) * float(turned @ turned))
    opposed = size > 0 and float(integrated @ turned) < -0.7 * size
    long = max(short, round(min(_WINDOW, 0.1 * float(t[-1] - t[0])) / dt))
    d = _change(x + 1j * y, long)
    if float(np.hypot(u, v).mean()) * (t[-1] - t[0]) >= 1.0 and d.std() > 0:
        _check_positions(d, _Moved(t, psi, u, v, long), noise, opposed)
        steps = {min(long * more, len(t) // 4) for more in (1, 4)}
        factors = [_sway_factor(_change(x + 1j * y, step), _Moved(t, psi, u, v, step)) for step in steps]
        slope, spread = min(factors, key=lambda factor: factor[1])
        if abs(slope + 1) < 0.5 and slope < -_CERTAIN * spread:
            raise ContradictionError(
                f"v has the opposite sign of the sway that positions show; {_mend('v', 'scale = -1')}"
            )
    if opposed:
        raise ContradictionError(f"r has the opposite sign of the rate of psi; {_mend('r', 'scale = -1')}")


def check_commands(t: Array, commands: Array, measured: Array, names: tuple[str, str]) -> None:
    """Raise ContradictionError if a command changes u or r in the opposite direction.

    The changes of a speed are explained by the mean command, the speed, the current and the product of the other two
    speeds, as by the equations of motion.
    """
    _, _, psi, u, v, r = measured.T
    dt, one = float(np.median(np.diff(t))), np.ones(len(t))
    motions = ("u", u, (u, v * r, np.cos(psi), np.sin(psi), one)), ("r", r, (r, u * v, one))
    for name, command, (motion, speed, others) in zip(names, commands.T, motions, strict=True):
        certainty = 0.0
        for step in (max(1, round(window / dt)) for window in _RESPONSE):
            if command.std() > 0 and len(t) >= 20 * step:
                mean = _change(np.append(0.0, np.cumsum(command))[:-1], step) / step
                regressors = np.column_stack((mean, *(other[:-step] for other in others)))
                certainty = max(certainty, _certainty(regressors, _change(speed, step), step), key=abs)
        if certainty < -_CERTAIN:
            raise ContradictionError(
                f"{name} has the opposite sign of the change of {motion}; {_mend(name, 'scale = -1')}"
            )


def _certainty(regressors: Array, values: Array, step: int) -> float:
    """Return the first coefficient of a linear fit in standard deviations, for windows of rows that overlap."""
    q, triangle = np.linalg.qr(regressors[:, [*range(1, regressors.shape[1]), 0]])
    last = q[:, -1] * np.sign(triangle[-1, -1])  # the part of the first regressor that the others do not explain
    if abs(triangle[-1, -1]) < 1e-6 * np.linalg.norm(regressors[:, 0]):
        return 0.0
    rest = values - q @ (q.T @ values)
    return float(last @ values) / math.sqrt(max(float(np.mean(rest**2)) * step, 1e-300))


class _Moved:
    """Integrals of the velocities over windows, in the complex plane, for other signs of psi and v."""

    def __init__(self, t: Array, psi: Array, u: Array, v: Array, step: int) -> None:
        self.t, self.psi, self.u, self.v, self.step = t, psi, u, v, step

    def __call__(self, turn: int = 1, sway: float = 1, ahead: float = 1, scale: float = 1.0) -> Array:
        """Return the integral of (ahead u + sway i v) exp(i turn psi), psi in units of `scale` radians."""
        direction = np.exp(1j * turn * scale * self.psi)
        return _integral((ahead * self.u + 1j * sway * self.v) * direction, self.t, self.step)


def _check_positions(d: Array, moved: _Moved, noise: Array, opposed: bool) -> None:
    """Raise ContradictionError if displacements have another angle, sense or size than integrals of velocities."""
    size = float(np.mean(np.abs(d) ** 2))
    usual = float(np.mean(np.abs(d - moved()) ** 2)) / size
    if usual < 0.05:
        return
    fits = {(turn, sway): _fit(moved(turn, sway), d) for turn in (1, -1) for sway in (1, -1)}
    sway = min((1, -1), key=lambda sign: fits[-1, sign][1])
    plain, mirrored = (min(fits[turn, 1][1], fits[turn, -1][1]) for turn in (1, -1))
    law = "x' = u cos(psi) - v sin(psi) must hold"
    if mirrored < _BETTER * min(plain, usual):
        if abs(fits[-1, 1][1] - fits[-1, -1][1]) < 0.1 * mirrored:  # v is too small to tell
            sway = 1 if opposed else -1
        a, _ = fits[-1, sway]
        angle = float(np.angle(a))
        if sway < 0 and not opposed:
            quarter = round(angle / (0.5 * math.pi))
            what, entries = {
                0: ("y seems to have the opposite sign", _mend("y", "scale = -1")),
                1: ("x and y look interchanged", 'in a format: x = "y", y = "x", or axes = "ENU" if v, r too are ENU'),
                -1: (
                    "x and y look interchanged, both with the opposite sign",
                    'in a format: x = "y", y = "x", scale -1',
                ),
            }.get(quarter, ("x seems to have the opposite sign", _mend("x", "scale = -1")))
        else:
            offset = f", offset = {angle:.3g}" if abs(angle) > _ANGLE else ""
            what, entries = "psi seems to have the opposite sign", _mend("psi", f"scale = -1{offset}")
            entries += "" if opposed else ", and r with scale = -1"
            entries += ", and v with scale = -1" if sway < 0 else ""
        raise ContradictionError(f"positions contradict heading and speeds: {what}; {law}; {entries}")
    a, unexplained = min((fits[1, 1], fits[1, -1]), key=lambda fit: fit[1])
    angle, along = float(np.angle(a)), float(np.abs(a))
    degrees, world = _fit(moved(scale=_DEGREE), d)[1], _fit(moved(scale=0.0), d)[1]
    if world <= degrees and world < _BETTER * min(usual, unexplained):
        raise ContradictionError(
            "positions contradict heading and speeds: u and v look like speeds along the axes of x and y; in a format: "
            'velocity = "world"'
        )
    if degrees < _BETTER * min(usual, unexplained):
        raise ContradictionError("positions contradict heading and speeds: psi looks like degrees; it must be in [rad]")
    if abs(angle) > _ANGLE and unexplained < _BETTER * min(usual, degrees):
        raise ContradictionError(
            f"positions contradict heading and speeds: they are turned by {math.degrees(angle):.0f} degrees; {law}; "
            f"{_mend('psi', f'offset = {-angle:.3g}')}, or exchange columns"
        )
    noisy = 2 * float(noise[:2] @ noise[:2]) / size
    still = moved() - moved().mean()  # without a current, which speeds through the water lack
    in_current = abs(_fit(still, d - d.mean())[0])
    if not (0.7 < along < 1.4 or 0.7 < in_current < 1.4) and unexplained < _UNEXPLAINED + noisy:
        hint = ": u and v look like knots" if 0.48 < along < 0.56 else ""
        hint = next((f": t looks like {unit}" for unit, size in _SMALL.items() if abs(along / size - 1) < 0.2), hint)
        raise ContradictionError(
            f"positions change {along:.3g} times as fast as u and v{hint}; both must be in SI units"
        )
    if unexplained > _UNEXPLAINED + noisy:
        raise ContradictionError(
            f"positions contradict heading and speeds, and no sign, angle or exchange of columns explains it; {law}"
        )


def _sway_factor(d: Array, moved: _Moved) -> tuple[float, float]:
    """Return the factor on v that explains the displacements best, and its standard deviation."""
    surge, sway = moved(sway=0), moved(ahead=0)
    rest, sway = d - surge - (d - surge).mean(), sway - sway.mean()
    power = max(float(np.sum(np.abs(sway) ** 2)), 1e-300)
    slope = float(np.real(np.vdot(sway, rest))) / power
    return slope, math.sqrt(float(np.mean(np.abs(rest - slope * sway) ** 2)) * moved.step / power)


def _fit(e: Array, d: Array) -> tuple[complex, float]:
    """Return the complex factor on e that explains d with the least squared error, and the share that it leaves."""
    power = max(float(np.sum(np.abs(e) ** 2)), 1e-300)
    a = complex(np.vdot(e, d)) / power
    return a, float(np.sum(np.abs(d - a * e) ** 2) / np.sum(np.abs(d) ** 2))


def _mend(name: str, entries: str) -> str:
    return f'in a format: {name} = {{ column = "{name}", {entries} }}'


def _change(values: Array, step: int) -> Array:
    return np.asarray(values[step:] - values[:-step])


def _integral(rate: Array, t: Array, step: int) -> Array:
    total = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)))
    return _change(total, step)


def _slope(x: Array, y: Array) -> float:
    """Return the slope of the line through the origin that explains y by x with the least squared error."""
    return float(x @ y / max(float(x @ x), 1e-300))
