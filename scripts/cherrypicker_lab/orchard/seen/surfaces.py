"""Points on the surfaces of a scene: trees as meshes, things, the ground; and their shadows."""

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.geometry.directions import unit
from cherrypicker_lab.orchard.scene.appearance import bark_relief, image_color, surface_color
from cherrypicker_lab.orchard.scene.ground import ground_color
from cherrypicker_lab.orchard.scene.mesh import NO_TREE


def on_mesh(rng, mesh, n):
    """Spread n points over a mesh by area: positions, normals, a dict of what is interpolated."""
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
    inside[near] = (distance < 0.9 * skeleton.radius[node]).any(1)
    return inside


def _part(points, normals, albedo, label, radius, tree):
    """Points of one thing; label, radius and tree are of all of them or of each."""
    n = len(points)
    return {
        "points": points, "normals": normals, "albedo": albedo,
        "label": np.full(n, label, np.uint8), "radius": np.full(n, radius, np.float64),
        "tree": np.full(n, tree, np.uint8),
    }  # fmt: skip


def _wood(rng, scene, trees, density, extent, is_colored):
    parts = []
    for thing in trees:
        tree = scene.trees[thing.tree]
        n = rng.poisson(density * thing.mesh.face_areas().sum())
        points, normals, attributes = on_mesh(rng, thing.mesh, n)
        axis = attributes["axis"]
        height = bark_relief(attributes["rest"], attributes["radius"], thing.material)
        points += height[:, None] * normals
        local = points - scene.offsets[thing.tree]
        keep = ~_inside_parent(tree, local, axis)
        keep &= ~_inside_sibling(tree, local, attributes["s"])
        keep &= np.hypot(points[:, 0], points[:, 1]) < extent
        albedo = np.empty((keep.sum(), 0))
        if is_colored:
            kept = {k: v[keep] for k, v in attributes.items()}
            albedo = surface_color(thing.material, kept, len(albedo))
        labels, radius = tree.labels[axis[keep]], attributes["radius"][keep]
        parts.append(_part(points[keep], normals[keep], albedo, labels, radius, thing.tree))
    return parts


def things(rng, scene, density, extent, *, most_m2=np.inf, is_colored=True, is_seen=False):
    """Points on all that is neither a tree nor the ground: a list of dicts as `surface` joins.

    A thing gets at most the points of `most_m2` square metres. Where it `is_seen`, points on an
    image whose material has `found` (the share of points that stereo finds, by texel) thin out.
    """
    parts = []
    for thing in scene.objects:
        n = rng.poisson(density * min(thing.mesh.face_areas().sum(), most_m2))
        points, normals, attributes = on_mesh(rng, thing.mesh, n)
        keep = np.hypot(points[:, 0], points[:, 1]) < extent
        keep &= points[:, 2] > scene.ground_height(points[:, :2]) - 0.002
        if is_seen and "found" in thing.material:
            keep &= rng.random(n) < image_color(thing.material["found"], attributes["uv"])
        if not keep.any():
            continue
        albedo = np.empty((keep.sum(), 0))
        if is_colored:
            albedo = surface_color(thing.material, attributes, n)[keep]
        parts.append(_part(points[keep], normals[keep], albedo, thing.label, thing.radius, NO_TREE))
    return parts


def ground(rng, scene, density, extent, *, is_colored=True):
    """Points on the ground, a dict as `surface` joins."""
    n = rng.poisson(density * np.pi * extent**2)
    r, a = extent * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    xy = np.column_stack([r * np.cos(a), r * np.sin(a)])
    step = 0.01
    z = scene.ground_height(xy)
    dx = (scene.ground_height(xy + [step, 0]) - z) / step
    dy = (scene.ground_height(xy + [0, step]) - z) / step
    normals = unit(np.column_stack([-dx, -dy, np.ones(n)]))
    albedo = np.empty((n, 0))
    if is_colored:
        albedo = ground_color(xy, scene.ground_seed, scene.ground_kind)
    return _part(np.column_stack([xy, z]), normals, albedo, Label.GROUND, 0.05, NO_TREE)


def surface(rng, scene, n_points, extent, ground_share, *, is_colored=True):
    """All surfaces, sized to about n_points; a dict of joined arrays."""
    trees = scene.tree_objects()
    middles = [t.mesh.vertices[t.mesh.faces].mean(1) for t in trees]
    inside = [np.hypot(middle[:, 0], middle[:, 1]) < extent for middle in middles]
    wood_area = sum(t.mesh.face_areas()[rows].sum() for t, rows in zip(trees, inside))
    other_area = sum(
        min(t.mesh.face_areas().sum(), 0.6 if t.label != Label.ROOF else 4.0) for t in scene.objects
    )
    density = n_points * (1 - ground_share) / (wood_area + other_area)
    parts = _wood(rng, scene, trees, density, extent, is_colored)
    parts += things(rng, scene, 0.7 * density, extent, is_colored=is_colored)
    floor = ground_share * n_points / (np.pi * extent**2)
    parts.append(ground(rng, scene, floor, extent, is_colored=is_colored))
    return {k: np.concatenate([part[k] for part in parts]) for k in parts[0]}


def lit(scene, cloud):
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
    tree = cKDTree(across[blockers], balanced_tree=False, compact_nodes=False)
    distance, nearest = tree.query(across, k=4, distance_upper_bound=0.007, workers=1)
    found = distance < 0.007
    gap = depth[blockers][np.where(found, nearest, 0)] - depth[:, None]
    shadow = (found & (gap > 0.03)).any(1)
    return np.where(shadow, 0.0, 1.0)
