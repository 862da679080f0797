"""How far the aligned vertical is off on walks, with and without the gravity that photos state.

The cloud is the scene as stereo would see it, the poses are the true ones, rolled as hands roll
them. What a phone states is simulated: each photo off by as much as the 23 real ones of
`../shared/data/photos/monstree` are off their common direction, all alike by a bias of the device.
"""

from dataclasses import replace

import numpy as np

from cherrypicker.geometry.directions import angle_deg
from cherrypicker.placement.align import align
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.presets import WALK_PRESETS
from cherrypicker_lab.orchard.scene.walks import preset_poses
from cherrypicker_lab.orchard.seen.as_seen import AsSeen
from cherrypicker_lab.orchard.seen.sampling import sample_scene

# Standard deviations in each axis: a median angle of 1.1 degrees between photos; the bias (guess)
PHOTO_DEG, DEVICE_DEG = 0.93, 0.5
SLOPE_DEG = 4.0  # of the ground of the second case, cameras and trees standing upright on it
N_POINTS, EXTENT_M = 150_000, 5.0
UP = np.array([0.0, 0.0, 1.0])


def measure_walk(name, shift=0):
    """Align a walk of `presets.WALK_PRESETS` four times.

    `shift` is added to the scene's seed: another tree and other hands. Returns ``walk``, ``shift``,
    and the vertical's error in degrees: ``level`` and ``slope`` from rolls and ground,
    ``level_gravity`` and ``slope_gravity`` with what the photos state.
    """
    preset = WALK_PRESETS[name]
    scene = generate_scene(**{**preset["scene"], "seed": preset["scene"]["seed"] + shift})
    poses = preset_poses(preset, scene)
    points = sample_scene(
        scene, N_POINTS, as_seen=AsSeen(), extent=EXTENT_M, rng=1, poses=poses
    ).points
    rng = np.random.default_rng([shift, sorted(WALK_PRESETS).index(name)])
    bias = rng.normal(0.0, np.radians(DEVICE_DEG), 3)
    ups = poses.rotations @ UP + bias + rng.normal(0.0, np.radians(PHOTO_DEG), (len(poses), 3))
    row = {"walk": name, "shift": shift}
    for case, slope in (("level", 0.0), ("slope", np.tan(np.radians(SLOPE_DEG)))):
        rise = slope * points[:, 0]
        cloud, cameras = points + rise[:, None] * UP, _risen(poses, slope)
        row[case] = _error(align(cloud, cameras))
        row[f"{case}_gravity"] = _error(align(cloud, cameras, stated_ups=list(ups)))
    return row


def _error(alignment):
    return angle_deg(alignment.rotation.T @ UP, UP)


def _risen(poses, slope):
    """The cameras as high above the sloping ground as above the level one, held as they were."""
    centers = poses.centers + slope * poses.centers[:, :1] * UP
    cam_from_world = poses.cam_from_world.copy()
    cam_from_world[:, :, 3] = -np.einsum("nij,nj->ni", cam_from_world[:, :, :3], centers)
    return replace(poses, cam_from_world=cam_from_world)
