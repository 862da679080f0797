"""Labelled point clouds of a scene: the exact surface, or as a dense reconstruction sees it."""

import numpy as np

from cherrypicker.pointcloud import PointCloud
from cherrypicker_lab.orchard.scene.appearance import encode_srgb
from cherrypicker_lab.orchard.seen.as_seen import AsSeen, see_scene
from cherrypicker_lab.orchard.seen.surfaces import lit, surface


def sample_scene(
    scene,
    n_points=60_000,
    *,
    rng=None,
    as_seen=None,
    extent=2.5,
    ground_share=0.45,
    exact=False,
    poses=None,
    is_colored=True,
):
    """Sample a labelled cloud from a scene, in the metric frame.

    There are about `n_points` points; what `as_seen` removes is made up for only roughly. `rng` is
    a generator or a seed, the scene's by default. Imperfections, `as_seen`, that are not given are
    drawn from it, and `poses` that are not given are the photos that these would take. Sampled is
    the radius `extent` (m) around the target's stem, with a share of the points, `ground_share`, on
    the ground. An `exact` cloud is the surface itself: it has no imperfections and no camera, and
    exactly lit colours, which take a third of the time and are left out where `is_colored` is
    false.

    Colours are sRGB in [0, 1]; the fields are `label` uint8 (the support post keeps 7) and `tree`
    uint8 (0 target, 1 and more for neighbours, 255 none).
    """
    if rng is None or isinstance(rng, int | np.integer):
        rng = np.random.default_rng([scene.seed if rng is None else int(rng), 5])
    if as_seen is None and not exact:
        as_seen = AsSeen.random(rng)
    if exact:
        cloud = surface(rng, scene, n_points, extent, ground_share, is_colored=is_colored)
        colors = np.empty((len(cloud["points"]), 0))
        if is_colored:
            light = lit(scene, cloud)
            colors = encode_srgb(scene.light.shade(cloud["albedo"], cloud["normals"], light))
    else:
        cloud = see_scene(
            scene, n_points, rng, as_seen, extent=extent, ground_share=ground_share, poses=poses
        )
        colors = cloud["colors"]
    points, label, tree = cloud["points"], cloud["label"], cloud["tree"]
    if len(points) > n_points:
        pick = np.sort(rng.choice(len(points), n_points, replace=False))
        points, colors, label, tree = points[pick], colors[pick], label[pick], tree[pick]
    return PointCloud(
        points,
        colors=np.clip(colors, 0, 1).astype(np.float32) if colors.shape[1] else None,
        fields={"label": label.astype(np.uint8), "tree": tree.astype(np.uint8)},
        frame="metric",
        unit="m",
    )
