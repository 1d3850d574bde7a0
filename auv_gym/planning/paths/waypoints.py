"""Waypoints: checks, and the conversion of geographic coordinates to metres."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.planning.paths.base import is_number

NEAR = 0.1
"""Distance [m] below which successive waypoints are one."""
EQUATOR, FLATTENING = 6378137.0, 1 / 298.257223563
"""Radius of the equator [m] and flattening of the ellipsoid WGS 84."""


class WaypointWarning(UserWarning):
    """Waypoints are merged, or a path leaves their polygon."""


def checked_waypoints(family: str, waypoints: Any, closed: bool) -> tuple[Array, list[int]]:
    """Return waypoints as an array (n, 2) [m], and their indices, without those that are `NEAR` the one before.

    Raises:
        ValueError: they are not finite pairs, too few, or all so near that they may be degrees.
    """
    try:
        points = np.asarray(waypoints, dtype=np.float64)
    except (OverflowError, TypeError, ValueError):
        points = np.empty(0)
    least = 3 if closed else 2
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < least:
        raise ValueError(f"{family}: waypoints must be {least} or more pairs (x, y), got {waypoints!r}")
    if not np.isfinite(points).all():
        bad = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise ValueError(f"{family}: waypoints must be finite, got {points[bad].tolist()} at waypoint {bad}")
    kept, near = [0], []
    for k in range(1, len(points)):
        if math.dist(points[k], points[kept[-1]]) < NEAR:
            near.append(k)
        else:
            kept.append(k)
    if closed and len(kept) > 1 and math.dist(points[kept[-1]], points[0]) < NEAR:
        near.append(kept.pop())
    if len(kept) < least:
        size = float(np.ptp(points, axis=0).max())
        hint = (
            "are these degrees? In a file name the columns lat and lon; `from_geographic` converts to metres"
            if size > 0
            else "they are one point"
        )
        raise ValueError(f"{family}: the waypoints are at most {size:.3g} m apart: {hint}")
    if near:
        warnings.warn(
            f"{family}: left out, since nearer than {NEAR} m to the one before: waypoint {', '.join(map(str, near))}",
            WaypointWarning, stacklevel=4,
        )  # fmt: skip
    return points[kept], kept


def check_speeds(family: str, speeds: Any, count: int, places: str, at: str) -> None:
    """Raise ValueError unless the speeds [m/s] are none, or one for each of `count` places and positive.

    In messages the places are `places`, and the k-th of them is "`at` k".
    """
    if not isinstance(speeds, Sequence) or len(speeds) not in (0, count):
        raise ValueError(f"{family}: speeds must be none or one for each of {count} {places}, got {speeds!r}")
    for k, value in enumerate(speeds):
        if not is_number(value, "positive"):
            raise ValueError(f"{family}: speeds must be finite and positive, got {value!r} {at} {k}")


def from_geographic(
    latitude: Sequence[float], longitude: Sequence[float], origin: tuple[float, float] | None = None
) -> Array:
    """Return the positions x (east), y (north) [m] of geographic coordinates, shape (n, 2).

    They are those in the tangent plane of the ellipsoid WGS 84 at the origin.

    Args:
        latitude: [deg] north.
        longitude: [deg] east.
        origin: latitude and longitude [deg] of x = y = 0; None: the first point.

    Raises:
        ValueError: a latitude is not in [-90, 90], or a longitude not in [-180, 360].
    """
    lat, lon = np.asarray(latitude, dtype=np.float64), np.asarray(longitude, dtype=np.float64)
    for name, values, low, high in (("latitude", lat, -90, 90), ("longitude", lon, -180, 360)):
        if not ((values >= low) & (values <= high)).all():
            bad = int(np.argmin((values >= low) & (values <= high)))
            raise ValueError(f"{name} of point {bad} is {values[bad]}; it must be in [{low}, {high}] degrees")
    lat_0, lon_0 = (float(lat[0]), float(lon[0])) if origin is None else origin
    away = _geocentric(lat, lon) - _geocentric(np.array([lat_0]), np.array([lon_0]))
    phi, lam = math.radians(lat_0), math.radians(lon_0)
    east = np.array((-math.sin(lam), math.cos(lam), 0.0))
    north = np.array((-math.sin(phi) * math.cos(lam), -math.sin(phi) * math.sin(lam), math.cos(phi)))
    return np.asarray(away @ np.stack((east, north), axis=1))


def _geocentric(latitude: Array, longitude: Array) -> Array:
    """Return the geocentric coordinates [m] of points of the ellipsoid, shape (n, 3)."""
    phi, lam, e_2 = np.radians(latitude), np.radians(longitude), FLATTENING * (2 - FLATTENING)
    N = EQUATOR / np.sqrt(1 - e_2 * np.sin(phi) ** 2)
    x, y = N * np.cos(phi) * np.cos(lam), N * np.cos(phi) * np.sin(lam)
    return np.stack((x, y, N * (1 - e_2) * np.sin(phi)), axis=1)
