"""A scene as our dense stage would reconstruct it from photos, without taking the photos.

The model works on points of the exact surface, each with the photos that see it, and one of them,
from whose pixel it is taken to come:

- What fewer than `min_views` photos see is missing.
- Depth is wrong along the ray by ``match_px * z^2 / (f b)``, b the distance between neighbouring
  photos; on wood thinner than the matching window more so, and by heavy tails.
- The window flattens a branch: its relief towards the photo shrinks by ``exp(-r / flatten)``.
- A silhouette takes ``spill_px`` of the background along. Pixels there mix the colours of wood and
  of what lies behind it in the photo's ray: sky, or ground. These are the sky-coloured fringes.
- Wood of few pixels' width is lost piece by piece.
- Floaters lie off along the ray, holes are spheres without points.

The parameters' defaults are fitted to what the dense stage made of rendered photos, see
docs/lab/orchard.md; `AsSeen.random` draws other scans around them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from cherrypicker_lab.orchard.scene.appearance import encode_srgb
from cherrypicker_lab.orchard.scene.backdrop import backdrop
from cherrypicker_lab.orchard.scene.cameras import CameraModel, Ring, ring_poses
from cherrypicker_lab.orchard.scene.ground import ground_color
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.orchard.scene.noise import fbm
from cherrypicker_lab.orchard.seen.seen_surface import paint, painted_surface, select
from cherrypicker_lab.orchard.seen.surfaces import lit
from cherrypicker_lab.orchard.seen.visibility import choose_views

SPILL_REACH_PX = 2.0  # radius of wood at which a silhouette grows by 1/e of that of a twig
SKY_ELEVATION = 0.06  # sine over which the sky begins
NEIGHBOURS = 4  # photos whose distance is the baseline
OVERSAMPLE = 2.2
THIN_THING_M = 0.01  # wires and threads are lost as twigs are


@dataclass(frozen=True)
class AsSeen:
    """How a scan was taken and what stereo makes of it. Lengths in m, shares in [0, 1]."""

    n_photos: int = 46  # in rings around the tree
    pixel_m: float = 0.0027  # size of a pixel at the tree; only where the photos are not given
    arc_deg: float = 360.0  # part of the way around the tree that the photographer walked
    min_views: int = 3  # photos that must see a point
    match_px: float = 0.05  # standard deviation of the stereo's disparity on thick wood, pixels
    thin_noise: float = 7.0  # how many times more is added to it on thin wood
    thin_m: float = 0.014  # radius of wood that still has 1/e of that
    tail: float = 0.01  # share of points with five times the noise
    flatten_m: float = 0.02  # radius of wood that keeps 1 - 1/e of its relief towards the photo
    # sink_m, sink_share: how far wood lies too deep on average, and what thin wood adds to it, of
    # its radius
    sink_m: float = 0.0004
    sink_share: float = 0.14
    jitter_px: float = 0.1  # standard deviation of the noise that has no direction, pixels
    spill_px: float = 1.1  # growth of silhouettes of thin wood, pixels
    blur_px: float = 1.5  # standard deviation of a pixel's footprint (median)
    # Chance to lose a pixel that is all background, on a silhouette; mixed ones in proportion
    mixed_loss: float = 0.1
    clutter_loss: float = 0.8  # the same for a pixel before anything but the sky, besides
    # width_px, width_soft_px: width of wood at which half is lost, and how gradually
    width_px: float = 0.6
    width_soft_px: float = 0.6
    patchiness: float = 0.9  # how much of that loss comes in pieces of some centimetres
    # n_holes, hole_radius_m: spherical holes, half of them on wood
    n_holes: int = 0
    hole_radius_m: float = 0.06
    density_sigma: float = 0.2  # strength of the smooth density variation (log scale)
    floaters: float = 0.002  # false points relative to all points
    floater_reach_m: float = 0.03  # their typical distance from what they copy
    color_noise: float = 0.02  # standard deviation of the colours' noise

    @classmethod
    def random(cls, rng):
        """Draw a scan: from better than the demo's to a poor one with few photos."""
        scale = np.exp(rng.normal(0.0, 0.35))
        return cls(
            n_photos=int(rng.integers(16, 70)),
            pixel_m=0.0027 * scale,
            arc_deg=360.0 if rng.random() < 0.75 else rng.uniform(150.0, 330.0),
            min_views=int(rng.choice([2, 3, 4])),
            match_px=0.05 * np.exp(rng.normal(0.0, 0.6)),
            thin_noise=rng.uniform(2.0, 12.0),
            thin_m=rng.uniform(0.008, 0.02),
            tail=rng.uniform(0.0, 0.05),
            flatten_m=rng.uniform(0.008, 0.03),
            sink_m=rng.uniform(-0.0005, 0.001),
            sink_share=rng.uniform(0.0, 0.25),
            jitter_px=rng.uniform(0.05, 0.5),
            spill_px=rng.uniform(0.3, 2.4),
            blur_px=rng.uniform(0.7, 2.3),
            mixed_loss=rng.uniform(0.0, 0.6),
            clutter_loss=rng.uniform(0.0, 1.0),
            width_px=rng.uniform(0.2, 2.6),
            width_soft_px=rng.uniform(0.4, 1.9),
            patchiness=rng.uniform(0.2, 1.0),
            n_holes=int(max(rng.integers(-4, 10), 0)),
            hole_radius_m=rng.uniform(0.02, 0.12),
            density_sigma=rng.uniform(0.1, 0.8),
            floaters=rng.choice([0.0, 0.002, 0.008]),
            floater_reach_m=np.exp(rng.uniform(np.log(0.01), np.log(0.2))),
            color_noise=rng.uniform(0.01, 0.05),
        )

    def poses(self, scene):
        """Photos of a scene as this scan would take them: one to three rings, the tree in frame."""
        height = max(scene.target.height, 1.0)
        distance = np.clip(1.1 * height, 1.5, 5.0)
        focal = distance / self.pixel_m
        size = int(1.35 * height / self.pixel_m)
        camera = CameraModel(width=int(0.8 * size), height=size, focal_px=focal)
        n_rings = 1 + (self.n_photos >= 18) + (self.n_photos >= 40)
        split = {1: [1.0], 2: [0.5, 0.5], 3: [0.42, 0.42, 0.16]}[n_rings]
        levels = [0.48, 0.8, 0.25]
        rings = [
            Ring(
                max(int(round(share * self.n_photos)), 3), min(level * height, 2.6), distance,
                0.5 * height, 0.17 * i,
            )
            for i, (share, level) in enumerate(zip(split, levels))
        ]  # fmt: skip
        poses = ring_poses(
            rings, camera, seed=scene.seed, ground=scene.ground_height,
            obstacles=scene.neighbour_wood(),
        )  # fmt: skip
        if self.arc_deg >= 360.0:
            return poses
        azimuth = np.degrees(np.arctan2(poses.centers[:, 1], poses.centers[:, 0]))
        first = (scene.seed * 137.5) % 360.0
        return poses.select((azimuth - first) % 360.0 <= self.arc_deg)


def _baselines(centers):
    """Distance of each photo to its nearest ones, (n,), m."""
    distance = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    near = np.sort(distance, axis=1)[:, 1 : NEIGHBOURS + 1]
    return np.maximum(np.median(near, axis=1), 0.05)


def _holes(rng, cloud, seen):
    """Which points do not lie in a hole."""
    points = cloud["points"]
    keep = np.ones(len(points), bool)
    if not seen.n_holes:
        return keep
    wood = np.flatnonzero(cloud["tree"] != NO_TREE)
    n_wood = seen.n_holes // 2 if len(wood) else 0
    pick = [rng.choice(wood, n_wood)] if n_wood else []
    pick.append(rng.integers(len(points), size=seen.n_holes - n_wood))
    for centre in points[np.concatenate(pick)]:
        radius = seen.hole_radius_m * rng.uniform(0.5, 1.5)
        keep &= np.linalg.norm(points - centre, axis=1) >= radius
    return keep


def _moved(rng, cloud, seen, rays, pixel, sigma):
    """Positions that stereo gives, and how much of their pixel is the surface itself, (n,)."""
    points, normals, radius = cloud["points"], cloud["normals"], cloud["radius"]
    wood = cloud["tree"] != NO_TREE
    flatness = np.exp(-((radius / seen.flatten_m) ** 1.5)) * wood
    spread = sigma * (1.0 + seen.thin_noise * np.exp(-((radius / seen.thin_m) ** 2)) * wood)
    spread = np.where(rng.random(len(points)) < seen.tail, 5.0, 1.0) * spread
    sink = seen.sink_m + seen.sink_share * radius * np.exp(-((radius / seen.thin_m) ** 2))
    along = rng.normal(size=len(points)) * spread - np.where(wood, sink, 0.0)
    # cross-section of a branch: towards the photo (height) and across the ray (side)
    forward = rays - np.einsum("ij,ij->i", rays, cloud["tangents"])[:, None] * cloud["tangents"]
    forward /= np.maximum(np.linalg.norm(forward, axis=1), 1e-6)[:, None]
    cosine = np.einsum("ij,ij->i", normals, forward)
    across = normals - cosine[:, None] * forward
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-6)[:, None]
    height = radius * np.clip(cosine, 0.0, 1.0)
    side = radius * np.sqrt(np.clip(1.0 - cosine**2, 0.0, 1.0))
    grown = side * (
        1.0 + seen.spill_px * pixel * np.exp(-radius / (SPILL_REACH_PX * pixel)) / radius
    )
    flat = flatness * (0.25 * np.pi * radius - height)
    shift = np.where(wood, flat, 0.0)[:, None] * forward
    shift += np.where(wood, grown - side, 0.0)[:, None] * across
    jitter = rng.normal(size=points.shape) * (seen.jitter_px * pixel)[:, None]
    # footprints differ: photos in and out of focus, fused from several
    blur = seen.blur_px * pixel * np.exp(rng.normal(0.0, 0.5, len(points)))
    cover = ndtr((radius - grown) / blur) - ndtr((-radius - grown) / blur)
    return points + shift + along[:, None] * rays + jitter, np.where(wood, cover, 1.0)


def _behind(scene, points, rays):
    """Linear colours of what lies behind points, seen along a ray from them to the photo."""
    away = -rays
    radiance, _ = backdrop(away, scene.light.sky, scene.seed)
    down = away[:, 2] < -0.02
    hit = points[down] - (points[down, 2] / away[down, 2])[:, None] * away[down]
    near = np.hypot(hit[:, 0], hit[:, 1]) < 40.0
    index = np.flatnonzero(down)[near]
    up = np.tile([0.0, 0.0, 1.0], (len(index), 1))
    floor = ground_color(hit[near, :2], scene.ground_seed, scene.ground_kind)
    radiance[index] = scene.light.shade(floor, up)
    return radiance


def see_scene(scene, n_points, rng, seen, *, extent=2.5, ground_share=0.45, poses=None, look=True):
    """Points of a scene as stereo from photos would give them.

    About `n_points` of them are left on average, as more are sampled by what is usually lost; the
    caller thins the rest out. `extent` and `ground_share` are as in `sample_scene`; the photos are
    those of `seen` by default. With `look`, colours are as a random camera would give them, not
    exactly lit.

    Returns arrays by name: `points` (n, 3), `colors` (n, 3) sRGB, `label`, `tree` uint8, `normals`
    (n, 3) and `radius` of the surface that a point comes from. Raises a ValueError if the photos
    see nothing of the scene.
    """
    poses = seen.poses(scene) if poses is None else poses
    focal = poses.K[:, 0, 0]
    widen = seen.spill_px * np.median(np.linalg.norm(poses.centers, axis=1) / focal)
    cloud, painters = painted_surface(
        rng, scene, OVERSAMPLE * n_points, extent, ground_share, widen
    )
    skeletons = [t.skeleton() for t in scene.trees]
    nodes = np.concatenate([s.points + o for s, o in zip(skeletons, scene.offsets)])
    n_views, photo = choose_views(
        rng, cloud["points"], cloud["normals"], poses, nodes,
        np.concatenate([s.radius for s in skeletons]),
    )  # fmt: skip
    keep = n_views >= seen.min_views
    if not keep.any():
        raise ValueError(f"{len(poses)} photos see nothing of the scene together")
    cloud, photo = select(cloud, keep), photo[keep]
    rays = poses.centers[photo] - cloud["points"]
    distance = np.linalg.norm(rays, axis=1)
    rays /= distance[:, None]
    baseline = _baselines(poses.centers)[photo] if len(poses) > 1 else 1.0
    pixel = distance / focal[photo]
    sigma = seen.match_px * pixel * distance / baseline
    points, cover = _moved(rng, cloud, seen, rays, pixel, sigma)
    keep = _kept(rng, cloud, seen, cover, pixel, rays)
    cloud, points, cover, rays = select(cloud, keep), points[keep], cover[keep], rays[keep]
    linear = scene.light.shade(paint(cloud, painters), cloud["normals"], lit(scene, cloud))
    mixed = np.flatnonzero(cover < 0.97)
    share = cover[mixed, None]
    behind = _behind(scene, points[mixed], rays[mixed])
    linear[mixed] = share * linear[mixed] + (1.0 - share) * behind
    colors = encode_srgb(linear)
    points = _float_off(rng, points, rays, cloud, colors, seen)
    if look:
        gain = np.exp(rng.normal(size=3) * 0.06 + rng.normal() * 0.16)
        colors = np.clip(colors, 0, 1) ** np.exp(rng.normal() * 0.12) * gain
        colors += rng.normal(size=colors.shape) * seen.color_noise
    return {
        "points": points, "colors": np.clip(colors, 0.0, 1.0), "label": cloud["label"],
        "tree": cloud["tree"], "normals": cloud["normals"], "radius": cloud["radius"],
    }  # fmt: skip


def _kept(rng, cloud, seen, cover, pixel, rays):
    """Which points stereo finds among those that enough photos see."""
    points, radius = cloud["points"], cloud["radius"]
    wood = (cloud["tree"] != NO_TREE) | (radius < THIN_THING_M)
    patches = fbm(points * 9, octaves=2, seed=int(rng.integers(1 << 30))) - 0.5
    width = 2 * radius / pixel + 6.0 * seen.patchiness * seen.width_soft_px * patches
    sharp = seen.width_soft_px * (1.0 - 0.8 * seen.patchiness)
    chance = 1.0 / (1.0 + np.exp(np.clip((seen.width_px - width) / sharp, -50, 50)))
    # a twig before the sky is a plain thing; before grass and other twigs stereo confuses the two
    before_land = rays[:, 2] > -SKY_ELEVATION
    lost = seen.mixed_loss + (1.0 - seen.mixed_loss) * seen.clutter_loss * before_land
    chance = np.where(wood, chance * (1.0 - lost * (1.0 - cover)), 1.0)
    variation = fbm(points * 2.2, octaves=3, seed=int(rng.integers(1 << 30))) - 0.5
    relative = np.exp(4.0 * seen.density_sigma * variation)
    chance *= np.clip(relative / np.quantile(relative, 0.85), 0, 1)
    return _holes(rng, cloud, seen) & (rng.random(len(points)) < chance)


def _float_off(rng, points, rays, cloud, colors, seen):
    """Move a few points off along their rays; half of those keep only a part of their colour."""
    is_off = rng.random(len(points)) < seen.floaters
    n = int(is_off.sum())
    reach = rng.laplace(size=n) * seen.floater_reach_m
    points = points.copy()
    points[is_off] += reach[:, None] * rays[is_off] + rng.normal(size=(n, 3)) * 0.003
    tone = np.array([0.72, 0.80, 0.92]) + rng.uniform(-0.12, 0.08) * np.array([1.5, 1.1, 0.6])
    mix = rng.uniform(0.0, 1.0, (n, 1)) * (cloud["tree"][is_off] != NO_TREE)[:, None]
    colors[is_off] = colors[is_off] * (1 - mix) + tone * mix
    return points
