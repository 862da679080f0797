"""Alignment: turn the scene upright, put the ground below what the cameras look at to z = 0.

The paper (section Alignment) fits a ground plane by RANSAC, rotates its normal onto z by Rodrigues'
formula, and turns the cloud over when its centre of mass lies below: the options plane "ransac",
up_from "ground" and flip "mass". The default differs in two points.
Several planes are tried and judged by the camera poses too, since the largest plane may be a wall.
The vertical then joins the ground's normal with the cameras' rolls, each by its own uncertainty,
since ground near a tree is rarely level while photos taken all around it average out to level;
where the photos state gravity themselves, that takes the place of the rolls.
The x/y origin is what the cameras look at. Which tree stands there is not asked here: without a
scale and without classes a stem, a post and a sign look alike.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import thin_randomly, voxel_sample
from cherrypicker.placement.camera_geometry import (
    CameraUp,
    angle_deg,
    camera_up,
    look_at_point,
    photographer_axes,
    roll_costs,
    tangent_basis,
    unit,
)
from cherrypicker.placement.gravity import contradiction, gravity_up
from cherrypicker.placement.ground import (
    Plane,
    ground_height_at,
    ground_tilt,
    ground_tolerance,
    judge_plane,
    largest_plane,
    plane_candidates,
)
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)

_MIN_POINTS = 100
# Below this product of factors a plane is no ground: 0.6 for each of six would be a poor one.
_MIN_SCORE = 0.02
_SUBSAMPLE = 400_000  # bounds the time
# Guesses; lengths are shares of the cameras' distance to what they look at
_PLANES_WITHIN = 4
_AROUND = 0.12  # radius of the ground below the target
_MASS_WITHIN = 1.5
_LOW_WITHIN, _LOW_PERCENTILE = 0.5, 1  # what stands for the ground where no plane does
_LEAST_SLOPE, _LEAST_COSINE = 0.3, 0.1  # keep divisions finite
_SLOPES_DEG = 5  # a ground that is off the cameras' up by more is worth a warning,
_SURE = 2  # where the cameras are this much surer
_MAX_COST, _MAX_SIGMA_DEG = 0.45, 15  # beyond them the cameras tell no vertical
_LEAST_MARGIN = 0.05  # of the cameras' cost upside down


@dataclass
class Alignment:
    """Rigid transform into the aligned frame, ``x' = rotation @ x + translation``."""

    rotation: np.ndarray  # (3, 3)
    translation: np.ndarray  # (3,)
    report: dict  # angles, candidates, sign checks and warnings, as written to align.json

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Aligned coordinates of points of shape (n_points, 3)."""
        return points @ self.rotation.T + self.translation


def rodrigues(source: ArrayLike, destination: ArrayLike) -> np.ndarray:
    """Rotation of the unit vector `source` onto `destination` by Rodrigues' formula.

    Parameters
    ----------
    source, destination : array-like of shape (3,)

    Returns
    -------
    ndarray of shape (3, 3)
        The smallest rotation; for opposite vectors a half turn about an axis orthogonal to both.
    """
    source, destination = unit(source), unit(destination)
    axis = np.cross(source, destination)
    sine, cosine = np.linalg.norm(axis), float(source @ destination)
    if sine < 1e-12:
        if cosine > 0:
            return np.eye(3)
        axis = tangent_basis(source)[0]
        return 2 * np.outer(axis, axis) - np.eye(3)
    x, y, z = axis / sine
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + sine * k + (1 - cosine) * (k @ k)


@dataclass(frozen=True)
class AlignOptions:
    """How the vertical is found; the fields are the config keys of ``align``."""

    ground_distance_fraction: float = 0.03
    plane: str = "judged"
    n_planes: int = 5
    up_from: str = "auto"
    flip: str = "cameras"


def align(
    points: np.ndarray,
    poses: Poses,
    options: AlignOptions | None = None,
    *,
    stated_turns: np.ndarray | None = None,
    stated_ups: Sequence[np.ndarray | None] | None = None,
    seed: int = 0,
) -> Alignment:
    """Find the transform that turns a reconstruction upright.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Dense cloud in COLMAP's frame, arbitrary scale.
    poses : Poses
        Same frame.
    stated_turns : ndarray of shape (n_cameras,), int, optional
        Quarter turns of the stored photos according to EXIF
        (:func:`cherrypicker.placement.camera_geometry.turns_from_exif`).
    stated_ups : sequence of (ndarray of shape (3,) or None), optional
        The way up in each camera's axes according to the phone
        (:func:`cherrypicker.intake.gravity.stated_up`).

    Raises
    ------
    StageError
        If the cloud or the poses are too few, or neither ground nor cameras tell the vertical.
    """
    options = options or AlignOptions()
    up_from = options.up_from
    _check_input(points, poses)
    points = np.asarray(thin_randomly(points, _SUBSAMPLE, seed), float)
    target, distance = look_at_point(poses, points)
    threshold = options.ground_distance_fraction * distance
    scene = _Scene(points, poses, stated_turns, stated_ups or [], target, distance, threshold)
    warnings: list[str] = []
    is_alone = options.plane == "ransac"  # the plane decides, whatever the cameras say
    planes = _judged_planes(scene, options, seed)
    ground = planes[0] if planes and (is_alone or planes[0].score >= _MIN_SCORE) else None
    if ground is not None and options.flip == "mass" and ground.height(scene.points).mean() < 0:
        ground.normal, ground.offset = -ground.normal, -ground.offset
    if ground is None:
        up, angles = _vertical_from_cameras(scene, up_from, seed, warnings)
    else:
        up, angles = _vertical_from_both(scene, ground, options, warnings)
        if options.flip == "mass" and up @ ground.normal < 0:
            up = -up
    rotation = rodrigues(up, [0.0, 0.0, 1.0])
    # The ground plane gives a first z = 0 under the target; the ground's true shape refines it.
    base = _ground_level(scene, ground, rotation)
    upright = (points - target) @ rotation.T - [0, 0, base]
    below = 0.0 if is_alone else _ground_below(upright, scene, warnings)
    origin = np.array([0.0, 0.0, below])
    translation = -(rotation @ target) - origin - np.array([0.0, 0.0, base])
    report = {
        "transform": np.vstack([np.column_stack([rotation, translation]), [0.0, 0.0, 0.0, 1.0]]),
        "camera_distance": distance,
        "look_at": rotation @ target + translation,
        "up_from": up_from,
        "plane": options.plane,
        "flip": options.flip,
        "ground_found": ground is not None,
        **angles,
        "half_turn": _half_turn_check(upright - origin, scene, up, warnings),
        "candidates": [_plane_report(plane, up) for plane in planes],
        "warnings": warnings,
    }
    for warning in warnings:
        logger.warning("%s", warning)
    return Alignment(rotation, translation, report)


@dataclass(frozen=True)
class _Scene:
    """The thinned cloud and what the poses say about it; `distance` is the unit of thresholds."""

    points: np.ndarray
    poses: Poses
    stated_turns: np.ndarray | None
    stated_ups: Sequence[np.ndarray | None]
    target: np.ndarray
    distance: float
    threshold: float


def _check_input(points: np.ndarray, poses: Poses) -> None:
    if len(points) < _MIN_POINTS:
        raise StageError(
            f"the dense cloud has only {len(points)} points, too few to find the ground", key="mvs"
        )
    if len(poses) < 2:
        raise StageError("fewer than two photos are registered", key="sfm.min_registered_fraction")


def _judged_planes(scene: _Scene, options: AlignOptions, seed: int) -> list[Plane]:
    """Candidate planes near the target, the best ground first; or the largest plane of all."""
    away = np.linalg.norm(scene.points - scene.target, axis=1)
    near = scene.points[away < _PLANES_WITHIN * scene.distance]
    thinned, *_ = voxel_sample(near if len(near) >= _MIN_POINTS else scene.points, scene.threshold)
    if options.plane == "ransac":
        planes = [largest_plane(scene.points, scene.threshold, seed=seed)]
    else:
        planes = plane_candidates(thinned, scene.threshold, n_planes=options.n_planes, seed=seed)
    for plane in planes:
        judge_plane(
            plane,
            thinned,
            scene.poses,
            target=scene.target,
            distance=scene.distance,
            inlier_distance=scene.threshold,
            stated_turns=scene.stated_turns,
        )
    planes.sort(key=lambda plane: -plane.score)
    for plane in planes:
        factors = ", ".join(f"{key} {value:.2f}" for key, value in plane.factors.items())
        logger.info(
            "plane candidate: %s of %s voxels, score %.3f (%s)",
            f"{plane.n_inliers:,}",
            f"{len(thinned):,}",
            plane.score,
            factors,
        )
    return planes


def _vertical_from_both(
    scene: _Scene, ground: Plane, options: AlignOptions, warnings: list[str]
) -> tuple[np.ndarray, dict]:
    """Up direction from the ground's far normal and the cameras, and the angles between them."""
    cameras = camera_up(scene.poses, stated_turns=scene.stated_turns, start=ground.normal)
    cameras, gravity = _with_gravity(scene, cameras, warnings)
    rotation = rodrigues(ground.normal, [0.0, 0.0, 1.0])
    flat = (scene.points - scene.target) @ rotation.T
    flat[:, 2] += ground.height(scene.target[None])[0]
    tilt, sigma_deg, near_far = ground_tilt(flat, scene.distance, scene.threshold)
    normal = ground.normal if options.plane == "ransac" else rotation.T @ tilt
    up = {
        "ground": normal,
        "cameras": cameras.up,
        "auto": _fuse(normal, sigma_deg, cameras.up, cameras.covariance),
    }[options.up_from]
    disagreement = angle_deg(normal, cameras.up)
    angles = {
        "ground_normal": normal,
        "ground_sigma_deg": sigma_deg,
        "ground_near_far_deg": near_far,
        **_camera_report(cameras),
        **gravity,
        "ground_to_cameras_deg": disagreement,
        "up_to_ground_deg": angle_deg(up, normal),
        "up_to_cameras_deg": angle_deg(up, cameras.up),
    }
    logger.info(
        "up: ground (+- %.2f deg) and cameras (+- %.2f deg) differ by %.2f deg; the result is "
        "%.2f deg from the ground's normal and %.2f deg from the cameras' up",
        sigma_deg,
        angles["cameras_sigma_deg"],
        disagreement,
        angles["up_to_ground_deg"],
        angles["up_to_cameras_deg"],
    )
    if disagreement > _SLOPES_DEG and angles["cameras_sigma_deg"] < disagreement / _SURE:
        warnings.append(
            f"the ground slopes by {disagreement:.1f} degrees against the cameras' mean up "
            f"direction (align.up_from is {options.up_from})"
        )
    return up, angles


def _vertical_from_cameras(
    scene: _Scene, up_from: str, seed: int, warnings: list[str]
) -> tuple[np.ndarray, dict]:
    """Up direction where no plane can be the ground."""
    cameras = camera_up(scene.poses, stated_turns=scene.stated_turns, seed=seed)
    cameras, gravity = _with_gravity(scene, cameras, warnings)
    report = _camera_report(cameras) | gravity
    if up_from == "ground":
        raise StageError("no plane of the cloud can be the ground", key="align.up_from")
    is_held_askew = cameras.cost > _MAX_COST and not gravity["gravity_is_used"]
    if is_held_askew or report["cameras_sigma_deg"] > _MAX_SIGMA_DEG:
        raise StageError(
            "no plane of the cloud can be the ground, and the cameras do not tell the vertical",
            key="align.ground_distance_fraction",
        )
    warnings.append(
        "no ground plane found: up is the cameras' mean up direction, z = 0 the lowest part of "
        "what they look at"
    )
    return cameras.up, report | {"ground_to_cameras_deg": None}


def _with_gravity(scene: _Scene, rolls: CameraUp, warnings: list[str]) -> tuple[CameraUp, dict]:
    """Put the gravity that the photos state in the place of their rolls; and what align.json says.

    Readings that contradict one another or the rolls by too much count for nothing.
    """
    gravity = gravity_up(scene.poses, scene.stated_ups)
    if gravity is None:
        return rolls, {"gravity_is_used": False}
    cause = contradiction(gravity, rolls)
    report = {
        "gravity_is_used": cause is None,
        "gravity_n_photos": gravity.n_photos,
        "gravity_spread_deg": gravity.spread_deg,
        "gravity_to_rolls_deg": angle_deg(gravity.up, rolls.up),
    }
    if cause is not None:
        warnings.append(f"what {gravity.n_photos} photos say of gravity is not used: {cause}")
        return rolls, report
    logger.info(
        "%d photos state gravity, to %.1f degrees in the median; %.1f degrees off their rolls",
        gravity.n_photos,
        gravity.spread_deg,
        report["gravity_to_rolls_deg"],
    )
    return replace(rolls, up=gravity.up, covariance=gravity.covariance), report


def _camera_report(cameras: CameraUp) -> dict:
    """What the cameras say about the vertical, for align.json."""
    sigma = np.sqrt(np.linalg.eigvalsh(cameras.covariance)[-1])
    return {
        "cameras_up": cameras.up,
        "cameras_sigma_deg": float(np.degrees(sigma)),
        "cameras_roll_std_deg": cameras.roll_std_deg,
        "cameras_quarter_turns": np.bincount(cameras.turns, minlength=4),
    }


def _fuse(
    normal: np.ndarray, sigma_deg: float, up: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """Join the ground's normal and the cameras' up by inverse variance.

    Where the two differ by more than their uncertainties allow, the ground is the one that slopes:
    its variance grows by the excess. Directions that the cameras leave open stay with the ground.
    """
    values, vectors = np.linalg.eigh(covariance)
    axes, variances = vectors[:, 1:].T, values[1:]  # the smallest belongs to `up` itself
    offset = axes @ (normal / max(normal @ up, _LEAST_COSINE))
    sigma2 = np.radians(sigma_deg) ** 2
    excess = np.maximum(0.0, offset**2 - variances - sigma2)
    share = variances / (variances + sigma2 + excess)
    return unit(up + (share * offset) @ axes)


def _ground_level(scene: _Scene, ground: Plane | None, rotation: np.ndarray) -> float:
    """First height of the ground under the target, which is the origin of the upright frame."""
    if ground is not None:
        # Down the vertical from the target to the plane.
        slope = (rotation @ ground.normal)[2]
        return float(-ground.height(scene.target[None])[0] / max(slope, _LEAST_SLOPE))
    upright = (scene.points - scene.target) @ rotation.T
    near = np.hypot(upright[:, 0], upright[:, 1]) < _LOW_WITHIN * scene.distance
    return float(np.percentile(upright[near, 2] if near.any() else upright[:, 2], _LOW_PERCENTILE))


def _ground_below(upright: np.ndarray, scene: _Scene, warnings: list[str]) -> float:
    """Height of the ground under the point that the cameras look at, hills and all."""
    tolerance = ground_tolerance(scene.distance, scene.threshold)
    z = ground_height_at(upright, (0.0, 0.0), _AROUND * scene.distance, tolerance)
    if z is None:
        warnings.append("no ground seen below what the cameras look at: z = 0 is only approximate")
        return 0.0
    return z


def _half_turn_check(
    aligned: np.ndarray, scene: _Scene, up: np.ndarray, warnings: list[str]
) -> dict:
    """The paper's check by centre of mass, beside what the cameras say about up and down."""
    near = np.hypot(aligned[:, 0], aligned[:, 1]) < _MASS_WITHIN * scene.distance
    mass = float(aligned[near, 2].mean()) if near.any() else float(aligned[:, 2].mean())
    costs, turns = roll_costs(scene.poses, np.stack([up, -up]), scene.stated_turns)
    margin = float(costs[1].mean() - costs[0].mean())
    _, up_axes = photographer_axes(scene.poses)
    mean_up = float((up_axes[np.arange(len(turns[0])), turns[0]] @ up).mean())
    stored_up = float((scene.poses.up @ up).mean())
    if mass <= 0 or margin < _LEAST_MARGIN:
        warnings.append(
            f"up and down may be swapped: centre of mass at z = {mass:.3g}, mean up of the photos "
            f"as stored z = {stored_up:.2f}"
        )
    return {
        "center_of_mass_z": mass,
        "cameras_mean_up_z": mean_up,
        "cameras_stored_up_z": stored_up,
        "cameras_margin": margin,
        "agree": bool(mass > 0 and margin > 0),
    }


def _plane_report(plane: Plane, up: np.ndarray) -> dict:
    """A candidate for align.json."""
    return {
        "score": plane.score,
        "n_inliers": plane.n_inliers,
        "angle_to_up_deg": angle_deg(plane.normal, up),
        "factors": plane.factors,
    }
