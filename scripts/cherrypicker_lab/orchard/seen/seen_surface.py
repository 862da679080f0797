"""Exact surface points for the model "as seen", which get their colours once they are found."""

import numpy as np

from cherrypicker.geometry.directions import unit
from cherrypicker_lab.orchard.scene.appearance import bark_relief, surface_color
from cherrypicker_lab.orchard.scene.buds import bud_mesh
from cherrypicker_lab.orchard.scene.ground import ground_color
from cherrypicker_lab.orchard.seen.surfaces import ground, on_mesh, things
from cherrypicker_lab.orchard.seen.tubes import sample_tubes

MOST_THING_M2 = 0.8  # a roof would take most of the points by its area alone


def select(cloud, keep):
    """Rows of all arrays of a dict, by a mask or an index array."""
    return {k: v[keep] for k, v in cloud.items()}


def _wood_area(tree, offset, extent):
    """Area (m2) of a tree's surface within `extent` of the z axis."""
    total = 0.0
    for axis in tree.axes:
        step = np.linalg.norm(np.diff(axis.points, axis=0), axis=1)
        middle = 0.5 * (axis.points[1:] + axis.points[:-1]) + offset
        inside = np.hypot(middle[:, 0], middle[:, 1]) < extent
        total += np.pi * ((axis.radii[1:] + axis.radii[:-1]) * step)[inside].sum()
    return total


def _wood(rng, scene, density, extent, widen):
    """Points on all trees, with tangents."""
    parts = []
    for number, (tree, offset) in enumerate(zip(scene.trees, scene.offsets)):
        sample = sample_tubes(rng, tree, density, widen=widen)
        at = sample.points + offset
        sample = sample.select(np.hypot(at[:, 0], at[:, 1]) < extent)
        # the same place on the bark as in the rendered mesh
        shift = np.random.default_rng([tree.bark_seed, 23]).uniform(-50, 50, (len(tree.axes), 3))
        around = sample.radius[:, None] * np.stack(
            [np.cos(sample.angle), np.sin(sample.angle)], axis=1
        )
        rest = np.column_stack([around, sample.s]) + shift[sample.axis]
        height = bark_relief(rest, sample.radius, tree.bark)
        at = {"rest": rest, "radius": sample.radius, "axis": sample.axis, "s": sample.s}
        points = sample.points + offset + height[:, None] * sample.normals
        parts.append(_bark(tree, number, points, sample.normals, sample.tangents, at))
        if tree.buds is not None:
            mesh = bud_mesh(tree.buds).moved(offset)
            n = rng.poisson(density * mesh.face_areas().sum())
            points, normals, at = on_mesh(rng, mesh, n)
            inside = np.hypot(points[:, 0], points[:, 1]) < extent
            at = {k: v[inside] for k, v in at.items()}
            whole = np.array([a.points[-1] - a.points[0] for a in tree.axes])
            along = unit(whole)[at["axis"]]
            parts.append(_bark(tree, number, points[inside], normals[inside], along, at))
    return parts


def _bark(tree, number, points, normals, tangents, at):
    """Points on a tree as the model needs them; `at`: where on its axes they lie."""
    return {
        "points": points, "normals": normals, "tangents": tangents, "radius": at["radius"],
        "label": tree.labels[at["axis"]], "tree": np.full(len(points), number, np.uint8),
        "paint": lambda rows: surface_color(tree.bark, select(at, rows), len(rows)),
    }  # fmt: skip


def painted_surface(rng, scene, n_points, extent, ground_share, widen):
    """Spread about `n_points` points over all surfaces.

    `extent` and `ground_share` are as in `sampling.sample_scene`; wood counts as wider by `widen`
    (m), see `tubes.sample_tubes`.

    Returns arrays by name: `points`, `normals`, `tangents` (n, 3), `radius` (n,), `label`, `tree`
    uint8, and `part` and `row`, which say whose points they are; and a list with a callable for
    each part, which makes linear colours (k, 3) for rows (k,) of it, see `paint`.
    """
    wood_area = sum(_wood_area(t, o, extent) for t, o in zip(scene.trees, scene.offsets))
    other_area = sum(min(t.mesh.face_areas().sum(), MOST_THING_M2) for t in scene.objects)
    density = n_points * (1 - ground_share) / (wood_area + other_area)
    parts = _wood(rng, scene, density, extent, widen)
    flat = things(rng, scene, 0.7 * density, extent, most_m2=MOST_THING_M2, is_seen=True)
    floor = ground_share * n_points / (np.pi * extent**2)
    flat.append(ground(rng, scene, floor, extent, is_colored=False))
    for part in flat:
        part["tangents"] = np.zeros_like(part["points"])
        part["paint"] = part.pop("albedo").__getitem__
    parts += flat
    xy = flat[-1]["points"][:, :2]
    parts[-1]["paint"] = lambda rows: ground_color(xy[rows], scene.ground_seed, scene.ground_kind)
    painters = [part.pop("paint") for part in parts]
    for number, part in enumerate(parts):
        part["part"] = np.full(len(part["points"]), number, np.int32)
        part["row"] = np.arange(len(part["points"]))
    return {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}, painters


def paint(cloud, painters):
    """Make the linear colours (n, 3) of a selection of `painted_surface`'s points."""
    albedo = np.empty((len(cloud["points"]), 3))
    for number, paint in enumerate(painters):
        here = np.flatnonzero(cloud["part"] == number)
        albedo[here] = paint(cloud["row"][here])
    return albedo
