"""What each part of the sky-silhouette filter is worth, on a scene whose truth is known.

Definitions, metres, the scene's frame, the judged region of
`cherrypicker_lab.dense.surface`:

- Fringe: a point of a dominant sky colour (within ``sky_color_distance``) that lies further than
  `FRINGE_M` from every true surface, the ground and all things included. Stereo put it beside a
  branch and gave it the sky's colour.
- Branch: a point within `BRANCH_M` of the target tree's true surface, of any colour.

What lies between is neither: stereo's own error, and the paper's filter is not meant for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.denoising.denoise import DenoiseOptions, denoise_cloud
from cherrypicker.pointcloud import PointCloud
from cherrypicker.sky.colors import SkyColors
from cherrypicker_lab.dense.surface import judge_points
from cherrypicker_lab.dense.truth import TrueSurface

#: Points further from all true surfaces are fringe, within this of the tree are branch.
FRINGE_M = 0.010
BRANCH_M = 0.005
#: The truth's other surfaces are sampled every 5 mm, so a point on them lies this near a sample.
OTHER_SAMPLE_M = 0.010

VARIANTS = ("off", "colour only", "mask voting only", "both")


def variant_options(options: DenoiseOptions, variant: str) -> DenoiseOptions:
    """Return the settings of one of `VARIANTS`; the other filters stay as they are."""
    changes = {
        "off": {"use_sky": False},
        "colour only": {"ask_photos": False},
        # every colour is near enough to be asked about
        "mask voting only": {"sky_color_distance": np.inf},
        "both": {},
    }
    return replace(options, **{"use_sky": True, **changes[variant]})


def judged_kinds(
    points: np.ndarray, sky_distance: np.ndarray, limit: float, surface: TrueSurface
) -> tuple[np.ndarray, np.ndarray]:
    """Say which points are fringe and which are branch.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        The scene's frame, metres.
    sky_distance : ndarray of shape (n,)
        Distance of each point's colour to the nearest dominant sky colour.
    limit : float
        Points nearer than this are of a sky colour.

    Returns
    -------
    is_fringe, is_branch : ndarrays of shape (n,), bool
    """
    judged = np.flatnonzero(judge_points(points, surface))
    gap = cKDTree(surface.points).query(points[judged], workers=-1)[0]
    away = gap > FRINGE_M
    if len(surface.others):
        reach = FRINGE_M + OTHER_SAMPLE_M
        other = cKDTree(surface.others).query(points[judged], distance_upper_bound=reach)[0]
        away &= np.isinf(other)
    is_fringe, is_branch = np.zeros((2, len(points)), bool)
    is_fringe[judged] = away & (sky_distance[judged] <= limit)
    is_branch[judged] = gap <= BRANCH_M
    return is_fringe, is_branch


def ablate(
    cloud: PointCloud,
    placed: np.ndarray,
    surface: TrueSurface,
    sky: SkyColors,
    evidence_of: Callable,
    options: DenoiseOptions,
    ground_height: float,
) -> list[dict]:
    """Run the denoising with parts of the sky filter and count what each variant takes.

    Parameters
    ----------
    cloud : PointCloud
        Cropped cloud with colours.
    placed : ndarray of shape (n, 3)
        Its points in the scene's frame.
    evidence_of : callable
        See `cherrypicker.denoising.denoise.denoise_cloud`.
    options : DenoiseOptions
        Of the full filter.
    ground_height : float
        See `cherrypicker.denoising.denoise.denoise_cloud`.

    Returns
    -------
    list of dict
        One a variant: ``variant``, ``n_removed``, ``n_fringe``, ``n_branch``,
        ``fringe_removed``, ``branch_lost`` (shares, None where there are no such points).
    """
    distance = sky.distance(cloud.colors)
    is_fringe, is_branch = judged_kinds(placed, distance, options.sky_color_distance, surface)
    table = []
    for variant in VARIANTS:
        by = denoise_cloud(
            cloud, sky, evidence_of, variant_options(options, variant), ground_height
        )[2]
        removed = by > 0
        table.append(
            {
                "variant": variant,
                "n_removed": int(removed.sum()),
                "n_fringe": int(is_fringe.sum()),
                "n_branch": int(is_branch.sum()),
                "fringe_removed": _share(removed, is_fringe),
                "branch_lost": _share(removed, is_branch),
            }
        )
    return table


def _share(removed: np.ndarray, among: np.ndarray) -> float | None:
    return float(removed[among].mean()) if among.any() else None


def markdown(tables: dict[str, list[dict]]) -> str:
    """Return the tables of several scenes as one of Markdown."""
    lines = [
        "| scene | sky filter | points removed | fringe removed | true branch points lost |",
        "| --- | --- | ---: | ---: | ---: |",
    ]
    for scene, table in tables.items():
        for row in table:
            shares = [
                "none" if row[key] is None else f"{100 * row[key]:.2f} %"
                for key in ("fringe_removed", "branch_lost")
            ]
            lines.append(
                f"| {scene} | {row['variant']} | {row['n_removed']:,} | "
                f"{shares[0]} of {row['n_fringe']:,} | {shares[1]} of {row['n_branch']:,} |"
            )
    return "\n".join(lines) + "\n"
