"""Alignment: turn the scene upright, put the ground below what the cameras look at to z = 0.

The paper (section Alignment) fits a ground plane by RANSAC, rotates its normal onto z by Rodrigues'
formula, and turns the cloud over when its centre of mass lies below: the options plane "ransac",
up_from "ground" and flip "mass". The default differs in two points.
Several planes are tried and judged by the camera poses too, since the largest plane may be a wall.
The vertical then is what the ground's normal, the cameras' rolls and the gravity that photos state
agree on (:mod:`cherrypicker.placement.up`), since ground near a tree is rarely level while photos
taken all around it average out to level.
The x/y origin is what the cameras look at. Which tree stands there is not asked here: without a
scale and without classes a stem, a post and a sign look alike.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.directions import angle_deg, rodrigues, tangent_basis, unit
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.placement.ground import (
    LOWEST_PERCENTILE,
    MIN_SCORE,
    MOST_POINTS,
    N_SPOT,
    SPOT_CELL,
    AlignOptions,
    find_ground,
    ground_plane,
)
from cherrypicker.placement.region import look_at_point
from cherrypicker.placement.up import MOST_DEG, Evidence, PhotosUp, photos_up, roll_costs, solve_up
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)

_MIN_POINTS = 100
# What ground near a tree is off level: as it counts (on the level walks of docs/lab/placement.md
# up is off by 0.38 degrees; with 1, 2 and 5 by 0.44, 0.53 and 0.58), and remarkably
_LEVEL_DEG, _SLOPE_DEG = 0.7, 5.0


@dataclass
class Alignment:
    """Rigid transform into the aligned frame, ``x' = rotation @ x + translation``."""

    rotation: np.ndarray  # (3, 3)
    translation: np.ndarray  # (3,)
    report: dict  # angles, candidates, sign checks and warnings, as written to align.json


def align(
    points: np.ndarray,
    poses: Poses,
    options: AlignOptions | None = None,
    *,
    stated_turns: np.ndarray | None = None,
    stated_ups: Sequence[np.ndarray | None] = (),
    seed: int = 0,
) -> Alignment:
    """Find the transform that turns a reconstruction upright, of any frame and unit.

    Its points are (n_points, 3). EXIF states by which quarter turns the photos are stored,
    (n_cameras,) int (:func:`cherrypicker.placement.up.turns_from_exif`), and the phone the way up
    in a camera's axes, (3,) or None (:func:`cherrypicker.intake.gravity.stated_up`).

    A `StageError` where points or poses are too few, or neither ground nor cameras tell the
    vertical.
    """
    options = options or AlignOptions()
    if len(points) < _MIN_POINTS:
        raise StageError(
            f"the dense cloud has only {len(points)} points, too few to find the ground", key="mvs"
        )
    if len(poses) < 2:
        raise StageError("fewer than two photos are registered", key="sfm.min_registered_fraction")
    points = np.asarray(thin_randomly(points, MOST_POINTS, seed), float)
    target, distance, _ = look_at_point(poses, points)
    ground, planes = find_ground(
        points, poses, target, distance, options, stated_turns=stated_turns, seed=seed
    )
    if ground is not None and options.flip == "mass" and ground.height(points).mean() < 0:
        ground.normal, ground.offset = -ground.normal, -ground.offset
    normal = None if ground is None else ground.normal
    photos = photos_up(poses, stated_turns=stated_turns, stated_ups=stated_ups, start=normal)
    warnings = list(photos.warnings)
    if ground is not None and options.plane != "ransac":  # its true shape refines the plane
        if ground.score < MIN_SCORE:
            warnings.append(
                "no photo frames the ground before the tree: the largest plane is taken for it "
                "that no photo speaks against"
            )
        turn = rodrigues(ground.normal)
        flat = (points - target) @ turn.T + [0.0, 0.0, ground.height(target)]
        shape = ground_plane(flat, distance)
        if shape is not None:
            normal = turn.T @ unit([-shape[1], -shape[2], 1.0])
    up, angles = _vertical(normal, photos, options, warnings)
    rotation = rodrigues(up)
    upright = (points - target) @ rotation.T
    is_near = np.hypot(upright[:, 0], upright[:, 1]) < distance
    near = upright[is_near if is_near.any() else slice(None), 2]  # heights
    if ground is None:
        level = float(np.percentile(near, LOWEST_PERCENTILE))
    else:  # the foot of the target on the plane
        level = -float(ground.height(target) * (up @ ground.normal))
    if options.plane != "ransac":
        spot = ground_plane(upright - [0.0, 0.0, level], distance, SPOT_CELL, N_SPOT)
        if spot is None:
            warnings.append(
                "no ground seen below what the cameras look at: z = 0 is only approximate"
            )
        else:
            level += float(spot[0])
    translation = -(rotation @ target) - [0.0, 0.0, level]
    mass = float(near.mean()) - level
    costs, _ = roll_costs(poses, [up, -up], stated_turns)
    margin = float(costs[1].mean() - costs[0].mean())
    is_upright = mass > 0 and margin > 0
    if not is_upright:
        warnings.append(
            f"up and down may be swapped: centre of mass at z = {mass:.3g}, and upside down the "
            f"photos fit by {margin:.2f} worse"
        )
    report = {
        "transform": np.vstack([np.column_stack([rotation, translation]), [0.0, 0.0, 0.0, 1.0]]),
        "camera_distance": distance,
        "look_at": rotation @ target + translation,
        "up_from": options.up_from,
        "plane": options.plane,
        "flip": options.flip,
        "ground_found": ground is not None,
        "cameras_up": photos.up,
        "cameras_sigma_deg": photos.sigma_deg,
        "cameras_roll_std_deg": photos.roll_std_deg,
        "cameras_quarter_turns": np.bincount(photos.turns, minlength=4),
        **photos.gravity,
        **angles,
        # The paper's check by centre of mass, beside what the cameras say
        "half_turn": {"center_of_mass_z": mass, "cameras_margin": margin, "agree": is_upright},
        "candidates": [
            {
                "score": plane.score,
                "allowed": plane.allowed,
                "n_inliers": plane.n_inliers,
                "angle_to_up_deg": angle_deg(plane.normal, up),
                "factors": plane.factors,
            }
            for plane in planes
        ],
        "warnings": warnings,
    }
    for warning in warnings:
        logger.warning("%s", warning)
    return Alignment(rotation, translation, report)


def _vertical(
    normal: np.ndarray | None, photos: PhotosUp, options: AlignOptions, warnings: list[str]
) -> tuple[np.ndarray, dict]:
    """Up direction from the photos and the ground's normal, if any, and the angles between them."""
    if normal is None:
        if options.up_from == "ground":
            raise StageError("no plane of the cloud can be the ground", key="align.up_from")
        is_held_askew = photos.roll_std_deg > MOST_DEG and not photos.gravity["gravity_is_used"]
        if is_held_askew or photos.sigma_deg > MOST_DEG:
            raise StageError(
                "no plane of the cloud can be the ground, and the cameras do not tell the vertical",
                key="align.ground_distance_fraction",
            )
        warnings.append(
            "no ground plane found: up is the cameras' mean up direction, z = 0 the lowest part of "
            "what they look at"
        )
        return photos.up, {"ground_to_cameras_deg": None}
    disagreement, explained = angle_deg(normal, photos.up), 2 * photos.sigma_deg
    if disagreement > max(_SLOPE_DEG, explained):
        warnings.append(
            f"the ground slopes by {disagreement:.1f} degrees against the cameras' mean up "
            f"direction (align.up_from is {options.up_from})"
        )
    up = normal if options.up_from == "ground" else photos.up
    if options.up_from == "auto":
        # What the photos do not allow is a slope: as much of its angle is no error of theirs.
        noise_deg = np.sqrt(max(_LEVEL_DEG**2, disagreement**2 - explained**2))
        level = Evidence(lambda up: (tangent_basis(normal) @ up)[None], np.radians(noise_deg))
        up, _ = solve_up([photos.evidence, level], normal)
    to_ground, to_cameras = angle_deg(up, normal), angle_deg(up, photos.up)
    logger.info(
        f"up: ground and cameras (+- {photos.sigma_deg:.2f} deg) differ by {disagreement:.2f} deg; "
        f"the result is {to_ground:.2f} deg from the ground's normal and {to_cameras:.2f} deg from "
        "the cameras' up"
    )
    return up, {
        "ground_normal": normal,
        "ground_to_cameras_deg": disagreement,
        "up_to_ground_deg": to_ground,
        "up_to_cameras_deg": to_cameras,
    }
