"""Labelled point clouds of a scene: the exact surface, or as a dense reconstruction sees it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.orchard.appearance import encode_srgb, ground_color, surface_color
from cherrypicker.orchard.mesh import NO_TREE
from cherrypicker.orchard.noise import fbm
from cherrypicker.pointcloud import PointCloud

__all__ = ["AsSeen", "sample_scene"]


@dataclass(frozen=True)
class AsSeen:
    """How a dense stereo cloud differs from the surface. Lengths in m, shares in [0, 1].

    Attributes
    ----------
    noise_m : float
        Standard deviation of the noise on thick wood near the stem.
    noise_growth : float
        Growth of the noise per metre away from the stem.
    fatten_m : float
        Mean outward shift of the points of thin wood (silhouettes grow).
    thin_loss : float
        Share of the points lost on the thinnest twigs; thick wood loses none.
    n_holes, hole_radius_m : int, float
        Spherical holes.
    side_loss : float
        Share of points lost on the surfaces that face away from a random direction.
    density_sigma : float
        Strength of the smooth density variation (log scale).
    fringe : float
        Sky-coloured points beside branches, relative to the number of branch points.
    floaters : float
        Isolated false points, relative to all points.
    color_noise : float
        Standard deviation of the colours' noise.
    """

    noise_m: float = 0.0018
    noise_growth: float = 0.5
    fatten_m: float = 0.0012
    thin_loss: float = 0.65
    n_holes: int = 5
    hole_radius_m: float = 0.06
    side_loss: float = 0.25
    density_sigma: float = 0.5
    fringe: float = 0.06
    floaters: float = 0.004
    color_noise: float = 0.03

    @classmethod
    def random(cls, rng):
        """Draw a mild to severe reconstruction."""
        return cls(
            noise_m=rng.uniform(0.0006, 0.005),
            noise_growth=rng.uniform(0.2, 0.9),
            fatten_m=rng.uniform(0.0, 0.004),
            thin_loss=rng.uniform(0.2, 0.95),
            n_holes=int(rng.integers(0, 12)),
            hole_radius_m=rng.uniform(0.02, 0.12),
            side_loss=rng.choice([0.0, 0.3, 0.8]),
            density_sigma=rng.uniform(0.1, 1.0),
            fringe=rng.uniform(0.0, 0.15),
            floaters=rng.uniform(0.0, 0.012),
            color_noise=rng.uniform(0.01, 0.06),
        )


def _on_mesh(rng, mesh, n):
    """n points spread by area; positions, normals and interpolated attributes."""
    areas = np.cumsum(mesh.face_areas())
    face = np.searchsorted(areas, rng.random(n) * areas[-1], side="right")
    corners = mesh.faces[np.minimum(face, len(mesh.faces) - 1)]
    r, t = np.sqrt(rng.random(n)), rng.random(n)
    w = np.stack([1 - r, r * (1 - t), r * t], axis=1)[..., None]  # (n, 3, 1)
    triangle = mesh.vertices[corners]
    normals = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-30
    attributes = {}
    for name, values in mesh.attributes.items():
        if np.issubdtype(values.dtype, np.integer):
            attributes[name] = values[corners[:, 0]]
        else:
            v = values[corners] if values.ndim == 2 else values[corners][..., None]
            attributes[name] = (w * v).sum(1) if values.ndim == 2 else (w * v).sum(1)[:, 0]
    return (w * triangle).sum(1), normals, attributes


def _inside_parent(tree, points, axis):
    """Points of an axis that lie inside the wood of its parent axis, near its start."""
    parents = np.array([a.parent for a in tree.axes])
    start = np.array([a.points[0] for a in tree.axes])
    along, radius = np.zeros_like(start), np.zeros(len(start))
    for i, a in enumerate(tree.axes):
        if a.parent >= 0:
            mother = tree.axes[a.parent]
            along[i] = mother.tangents[a.parent_node]
            radius[i] = mother.radii[a.parent_node]
    d = points - start[axis]
    lengthwise = np.einsum("ij,ij->i", d, along[axis])
    across = np.linalg.norm(d - lengthwise[:, None] * along[axis], axis=1)
    r = radius[axis]
    ends = np.array([a.parent >= 0 and a.parent_node == len(tree.axes[a.parent].points) - 1
                     for a in tree.axes])  # fmt: skip
    reach = np.where(ends[axis], 0.6 * r, 2.5 * r)  # past its last node the parent is a dome
    return (parents[axis] >= 0) & (across < 0.98 * r) & (lengthwise < reach)


def _inside_sibling(tree, points, s):
    """Points near an axis' start that lie inside another axis of the same fork."""
    skeleton = tree.skeleton()
    near = np.flatnonzero(s < 0.12)
    distance, node = cKDTree(skeleton.points).query(points[near], k=24, workers=1)
    inside = np.zeros(len(points), bool)
    inside[near] = (distance < 0.9 * skeleton.radii[node]).any(1)
    return inside


def _wood(rng, scene, density, extent):
    parts = []
    for thing in scene.tree_objects():
        tree = scene.trees[thing.tree]
        n = rng.poisson(density * thing.mesh.face_areas().sum())
        points, normals, attributes = _on_mesh(rng, thing.mesh, n)
        axis = attributes["axis"]
        local = points - scene.offsets[thing.tree]
        keep = ~_inside_parent(tree, local, axis)
        keep &= ~_inside_sibling(tree, local, attributes["s"])
        keep &= np.hypot(points[:, 0], points[:, 1]) < extent
        labels = np.array([int(a.label) for a in tree.axes], np.uint8)[axis]
        albedo = surface_color(
            thing.material, {k: v[keep] for k, v in attributes.items()}, keep.sum()
        )
        parts.append(
            (
                points[keep],
                normals[keep],
                albedo,
                labels[keep],
                attributes["radius"][keep],
                thing.tree,
            )
        )
    return parts


def _things(rng, scene, density, extent):
    parts = []
    for thing in scene.objects:
        n = rng.poisson(density * thing.mesh.face_areas().sum())
        points, normals, attributes = _on_mesh(rng, thing.mesh, n)
        keep = np.hypot(points[:, 0], points[:, 1]) < extent
        keep &= points[:, 2] > scene.ground_height(points[:, :2]) - 0.002
        if not keep.any():
            continue
        albedo = surface_color(thing.material, attributes, n)[keep]
        labels = np.full(keep.sum(), thing.label, np.uint8)
        radius = np.full(keep.sum(), 0.05)
        parts.append((points[keep], normals[keep], albedo, labels, radius, NO_TREE))
    return parts


def _ground(rng, scene, density, extent):
    n = rng.poisson(density * np.pi * extent**2)
    r, a = extent * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    xy = np.column_stack([r * np.cos(a), r * np.sin(a)])
    step = 0.01
    z = scene.ground_height(xy)
    dx = (scene.ground_height(xy + [step, 0]) - z) / step
    dy = (scene.ground_height(xy + [0, step]) - z) / step
    normals = np.column_stack([-dx, -dy, np.ones(n)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    labels = np.full(n, int(Label.GROUND), np.uint8)
    albedo = ground_color(xy, scene.ground_seed)
    return (np.column_stack([xy, z]), normals, albedo, labels, np.full(n, 0.05), NO_TREE)


def _area_within(mesh, extent):
    """Area (m2) of the faces that lie within `extent` of the z axis."""
    middle = mesh.vertices[mesh.faces].mean(1)
    return mesh.face_areas()[np.hypot(middle[:, 0], middle[:, 1]) < extent].sum()


def _surface(rng, scene, n_points, extent, ground_share):
    """All surfaces, sized to about n_points; a dict of joined arrays."""
    wood_area = sum(_area_within(t.mesh, extent) for t in scene.tree_objects())
    other_area = sum(
        min(t.mesh.face_areas().sum(), 0.6 if t.label != Label.ROOF else 4.0) for t in scene.objects
    )
    density = n_points * (1 - ground_share) / (wood_area + other_area)
    parts = _wood(rng, scene, density, extent) + _things(rng, scene, 0.7 * density, extent)
    parts.append(_ground(rng, scene, ground_share * n_points / (np.pi * extent**2), extent))
    names = ("points", "normals", "albedo", "label", "radius")
    cloud = {k: np.concatenate([p[i] for p in parts]) for i, k in enumerate(names)}
    cloud["tree"] = np.concatenate([np.full(len(p[0]), p[5], np.uint8) for p in parts])
    return cloud


def _thin_out(rng, scene, cloud, seen):
    """Indices of the points that a reconstruction would have found."""
    points, radius = cloud["points"], cloud["radius"]
    keep = np.ones(len(points))
    wood = cloud["tree"] != NO_TREE
    thinness = np.clip((0.009 - radius) / 0.006, 0, 1)
    # twigs vanish piece by piece, not point by point
    patches = fbm(points * 9, octaves=2, seed=int(rng.integers(1 << 30)))
    keep[wood & (patches < seen.thin_loss * thinness * 0.9)] = 0.0
    variation = fbm(points * 2.2, octaves=3, seed=int(rng.integers(1 << 30))) - 0.5
    relative = np.exp(4.0 * seen.density_sigma * variation)
    keep *= np.clip(relative / np.quantile(relative, 0.85), 0, 1)
    blind = rng.normal(size=3) * [1, 1, 0.5]
    blind /= np.linalg.norm(blind)
    keep[wood & (cloud["normals"] @ blind > 0.45)] *= 1.0 - seen.side_loss
    keep[(cloud["label"] == Label.ROOF) & (cloud["normals"][:, 2] > 0)] *= 0.2
    if seen.n_holes:
        # half of the holes sit on wood, where they cut a branch
        n_wood = seen.n_holes // 2
        pool = points[wood] if wood.any() else points
        centres = np.vstack(
            [pool[rng.integers(len(pool), size=n_wood)],
             points[rng.integers(len(points), size=seen.n_holes - n_wood)]]
        )  # fmt: skip
        radii = seen.hole_radius_m * rng.uniform(0.5, 1.5, len(centres))
        distance = np.linalg.norm(points[:, None] - centres[None], axis=2)
        keep[(distance < radii).any(1)] = 0.0
    return rng.random(len(points)) < keep


def _sky_tone(rng):
    return np.array([0.72, 0.80, 0.92]) + rng.uniform(-0.12, 0.08) * np.array([1.5, 1.1, 0.6])


def _fringe(rng, cloud, colors, seen):
    """Sky-coloured points just off the silhouettes of thin wood."""
    wood = np.flatnonzero((cloud["tree"] != NO_TREE) & (cloud["radius"] < 0.03))
    n = int(seen.fringe * len(wood))
    if n == 0:
        return None
    pick = rng.choice(wood, n)
    away = cloud["normals"][pick] * rng.uniform(0.001, 0.010, (n, 1))
    points = cloud["points"][pick] + away + rng.normal(size=(n, 3)) * 0.003
    mix = rng.uniform(0.3, 1.0, (n, 1))
    tint = colors[pick] * (1 - mix) + _sky_tone(rng) * mix + rng.normal(size=(n, 3)) * 0.03
    return points, tint, cloud["label"][pick], cloud["tree"][pick]


def _floaters(rng, cloud, colors, seen, extent):
    """Loose points in the air: small clusters and single ones, labelled as what they copy."""
    n = int(seen.floaters * len(cloud["points"]))
    wood = np.flatnonzero(cloud["tree"] != NO_TREE)
    if n == 0 or len(wood) == 0:
        return None
    pick = rng.choice(wood, n)
    points = cloud["points"][pick] + rng.normal(size=(n, 3)) * rng.uniform(0.01, 0.05, (n, 1))
    mix = rng.uniform(0.0, 1.0, (n, 1))
    tint = colors[pick] * (1 - mix) + _sky_tone(rng) * mix
    return points, tint, cloud["label"][pick], cloud["tree"][pick]


def _lit(rng, scene, cloud):
    """Rough shadows: a point is lit unless wood stands between it and the sun."""
    sun = scene.light.sun_direction
    wood = cloud["tree"] != NO_TREE
    if not wood.any() or scene.light.sun.max() < 0.3:
        return 1.0
    side = np.cross(sun, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    across = np.column_stack([cloud["points"] @ side, cloud["points"] @ np.cross(side, sun)])
    depth = cloud["points"] @ sun
    blockers = np.flatnonzero(wood)
    nearest = cKDTree(across[blockers]).query(across, k=4, workers=1)
    gap = depth[blockers][nearest[1]] - depth[:, None]
    shadow = ((nearest[0] < 0.007) & (gap > 0.03)).any(1)
    return np.where(shadow, 0.0, 1.0)


def _camera_look(rng, colors, strength):
    """Exposure, white balance and contrast of a random camera."""
    gain = np.exp(rng.normal(size=3) * 0.06 * strength + rng.normal() * 0.16 * strength)
    gamma = np.exp(rng.normal() * 0.12 * strength)
    return np.clip(colors, 0, 1) ** gamma * gain


def _jitter(rng, cloud, seen):
    """Positions with noise that grows with the distance and on thin wood, and fattened twigs."""
    points, normals = cloud["points"], cloud["normals"]
    distance = np.linalg.norm(points, axis=1)
    thin = np.clip((0.012 - cloud["radius"]) / 0.01, 0, 1)
    sigma = seen.noise_m * (1 + seen.noise_growth * distance) * (1 + 0.7 * thin)
    out = np.abs(rng.normal(size=len(points))) * seen.fatten_m * (0.3 + 0.7 * thin)
    out[cloud["tree"] == NO_TREE] = 0.0
    # a stereo error is mostly one of depth; depth directions differ from point to point
    isotropic = rng.normal(size=points.shape) * (0.5 * sigma)[:, None]
    return points + normals * (out + rng.normal(size=len(points)) * sigma)[:, None] + isotropic


def sample_scene(
    scene, n_points=60_000, *, rng=None, as_seen=None, extent=2.5, ground_share=0.45, exact=False
):
    """Sample a labelled cloud from a scene.

    Parameters
    ----------
    scene : Scene
    n_points : int, default 60000
        About how many points; what `as_seen` removes is made up for only roughly.
    rng : numpy.random.Generator or int, optional
        Generator or seed; the scene's seed by default.
    as_seen : AsSeen, optional
        Imperfections of a reconstruction; drawn from `rng` by default.
    extent : float, default 2.5
        Radius around the target's stem that is sampled, m.
    ground_share : float, default 0.45
        Share of the points that go to the ground.
    exact : bool, default False
        Sample the surface itself: no imperfections, no camera, exactly lit colours.

    Returns
    -------
    PointCloud
        Metric frame; colours sRGB in [0, 1]; fields `label` uint8 (the support post keeps 7) and
        `tree` uint8 (0 target, 1.. neighbours, 255 none).
    """
    if rng is None or isinstance(rng, int | np.integer):
        rng = np.random.default_rng([scene.seed if rng is None else int(rng), 5])
    if as_seen is None and not exact:
        as_seen = AsSeen.random(rng)
    wanted = n_points if exact else 1.7 * n_points
    cloud = _surface(rng, scene, wanted, extent, ground_share)
    if not exact:
        keep = _thin_out(rng, scene, cloud, as_seen)
        cloud = {k: v[keep] for k, v in cloud.items()}
    lit = _lit(rng, scene, cloud)
    colors = encode_srgb(scene.light.shade(cloud["albedo"], cloud["normals"], lit))
    points, label, tree = cloud["points"], cloud["label"], cloud["tree"]
    if not exact:
        extra = [
            _fringe(rng, cloud, colors, as_seen),
            _floaters(rng, cloud, colors, as_seen, extent),
        ]
        extra = [e for e in extra if e is not None]
        points = np.concatenate([_jitter(rng, cloud, as_seen), *[e[0] for e in extra]])
        colors = np.concatenate([colors, *[e[1] for e in extra]])
        label = np.concatenate([label, *[e[2] for e in extra]])
        tree = np.concatenate([tree, *[e[3] for e in extra]])
        colors = (
            _camera_look(rng, colors, 1.0) + rng.normal(size=colors.shape) * as_seen.color_noise
        )
    if len(points) > n_points:
        pick = np.sort(rng.choice(len(points), n_points, replace=False))
        points, colors, label, tree = points[pick], colors[pick], label[pick], tree[pick]
    return PointCloud(
        points,
        colors=np.clip(colors, 0, 1).astype(np.float32),
        fields={"label": label.astype(np.uint8), "tree": tree.astype(np.uint8)},
        frame="metric",
        unit="m",
    )
