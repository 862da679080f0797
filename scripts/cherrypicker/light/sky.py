"""Directions of the sky, and the sun's and the sky's light over a season from them."""

from dataclasses import dataclass
from datetime import date, timedelta

import numpy as np
from scipy.spatial import ConvexHull


def sky_directions(n: int = 200) -> np.ndarray:
    """Directions into the upper half of the sky, each standing for an equal solid angle.

    The Fibonacci lattice (Gonzalez, Mathematical Geosciences 42:49-64, 2010) on a half sphere:
    heights in the middle of equal bands, each a golden angle further round. Unit vectors, (n, 3).
    """
    z = (np.arange(n) + 0.5) / n
    azimuth = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)


@dataclass(frozen=True)
class SeasonLight:
    """What reaches a place from a clear sky over a season."""

    beam: np.ndarray  # (n_directions,): of the sun, from each, MJ/m2 of a surface across it
    diffuse: np.ndarray  # (n_directions,): the same of the sky, which is as bright all over


def season_light(
    directions: np.ndarray,
    latitude: float,
    longitude: float,
    season: tuple[str, str],
    *,
    north_deg: float = 90.0,
) -> SeasonLight:
    """Sum the clear sky's light over a season: Ineichen's model with pvlib's monthly turbidity.

    The directions (n, 3) are those of `sky_directions`. Latitude and longitude are in degrees,
    north and east positive; the season is its first and last day, ISO dates, days by the sun's
    time. North is `north_deg` from +x towards +y in the directions' frame.
    """
    import pandas
    import pvlib  # takes a second, and light without a place does without

    end = date.fromisoformat(season[1]) + timedelta(days=1)
    step = pandas.Timedelta(minutes=10)
    times = pandas.date_range(season[0], end.isoformat(), freq=step, tz="UTC", inclusive="left")
    # In the middle of each step, of days that begin at the sun's midnight
    times += step / 2 - pandas.Timedelta(minutes=4.0 * longitude)
    location = pvlib.location.Location(latitude, longitude)
    sun = location.get_solarposition(times)
    light = location.get_clearsky(times, solar_position=sun)
    megajoules = 1e-6 * step.total_seconds()
    height = np.radians(sun["apparent_elevation"].to_numpy())
    azimuth = np.radians(north_deg - sun["azimuth"].to_numpy())
    level = np.cos(height)
    to_sun = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(height)], axis=1)
    is_up = height > 0
    beam = _spread(directions, to_sun[is_up], megajoules * light["dni"].to_numpy()[is_up])
    # A uniform sky's radiance is a pi-th of what the level ground gets, from 2 pi of sky
    on_ground = megajoules * light["dhi"].sum()
    return SeasonLight(beam, np.full(len(directions), 2.0 * on_ground / len(directions)))


def _spread(directions: np.ndarray, to_sun: np.ndarray, energy: np.ndarray) -> np.ndarray:
    """Give each sun's energy to the three directions around it.

    Their weighted sum is the sun's own direction, so that a flat surface gets from them what it
    gets from the sun. Below the lowest directions their mirror images stand in.
    """
    corners = np.concatenate([directions, directions * [1.0, 1.0, -1.0]])
    triangles = ConvexHull(corners).simplices
    inverse = np.linalg.inv(corners[triangles].transpose(0, 2, 1))
    total = np.zeros(len(directions))
    for some in np.array_split(np.arange(len(to_sun)), len(to_sun) // 1000 + 1):
        weights = np.einsum("tij,nj->nti", inverse, to_sun[some])
        around = weights.min(axis=2).argmax(axis=1)
        shares = weights[np.arange(len(some)), around] * energy[some, None]
        np.add.at(total, triangles[around] % len(directions), shares)
    return total
