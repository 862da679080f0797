"""Config keys of the last release, read as the keys that replace them; gone with the next."""

from collections.abc import Iterable, Iterator, Mapping, MutableMapping

# Keys that are gone, each with what there is in its place
GONE = {
    "sfm.max_match_ratio": "COLMAP's own is taken",
    "sfm.max_epipolar_error_px": "COLMAP's own is taken",
    "sfm.min_inliers": "COLMAP's own is taken",
    "sfm.wanted_registered_fraction": "a second try is made for all that are not known",
    "sfm.retrieval_neighbors": "sfm.exhaustive_max_photos says where not all pairs are matched",
    "sfm.sequential_overlap": "sfm.exhaustive_max_photos says where not all pairs are matched",
    "mvs.max_reproj_error_px": "COLMAP's own is taken",
    "mvs.max_depth_error": "COLMAP's own is taken",
    "mvs.min_consistent": "COLMAP's own is taken",
    "denoise.use_statistical": "the filter is always on; denoise.std_ratio says how sharp",
    "denoise.use_sky": "the filter is always on; denoise.sky_color_distance says how wide",
    "graph.n_neighbors": "skeleton.n_neighbors is taken",
    "traits.slab_half_height_m": "it is 0.10",
    "traits.n_bootstrap": "it is 200",
    "segment.batch_spheres": "the network sees one sphere at a time",
    "sky.threshold": "what is likelier sky than not is sky",
    "sky.n_color_samples": "it is 20000",
    "sky.cluster_epsilon": "it is 0.02",
    "sky.cluster_min_density": "scikit-learn's own is taken",
    "sky.cluster_min_fraction": "it is 0.02",
    "denoise.n_neighbors": "it is 20, as in Open3D's example",
    "mvs.max_normal_error_deg": "it is 60",
    "traits.min_points": "it is 60",
    "traits.min_arc_deg": "it is 120",
    "align.n_planes": "it is 5",
    "scale.max_reprojection_px": "it is 2",
    "sky.guide_radius_px": "it is 60",
    "sky.guide_epsilon": "it is 0.001",
    "sfm.wanted_pair_agreement": "it is 0.9",
    "segment.min_visits": "it is 2",
    "mvs.use_sky_masks": "the CPU leaves clear sky out",
    "sfm.pairing": "sfm.exhaustive_max_photos says where not all pairs are matched",
    "mvs.geometric_weight": "it is 0.2",
    "mvs.max_error_px": "it is 1.5",
    "mvs.max_cost": "it is 0.7",
    "mvs.n_best": "it is 3",
    "mvs.window_radius": "it is 3",
    "mvs.color_spread": "the photo's noise tells it, up to 16",
    "mvs.min_texture": "it is 1.5",
}


def take_old_keys(config: MutableMapping, new: Iterable[str]) -> list[str]:
    """Rename old keys in place, and say in a line each what replaces them.

    The `new` keys are those of `skeleton`; but the method, all were in `contract` by these names.
    `skeleton.method` follows from three: `graph.method: tree` and `contract.preset: default` are
    limbs, `mst`, `paper` and `contract.method: lbc` alone are the contraction. A new key that is
    there wins. The keys of `GONE` are taken out.
    """
    lines = []
    for key, instead in GONE.items():
        section, name = key.split(".")
        if _taken(config, section, [name]):
            lines.append(f"{key} does nothing any more: {instead}")
    old = _taken(config, "contract", ("preset", "method")) | _taken(config, "graph", ("method",))
    moved = _taken(config, "contract", new)
    if old or moved:
        lines += _renamed(config, old, moved)
    return [f"{line}; the old key goes with the next release" for line in lines]


def _renamed(config: MutableMapping, old: Mapping, moved: Mapping) -> Iterator[str]:
    """Enter in ``skeleton`` what the three old keys and those that moved mean, and say so."""
    skeleton = config["skeleton"] = dict(config.get("skeleton") or {})
    if old:
        said = ", ".join(f"{key}: {value}" for key, value in old.items())
        if "method" in skeleton:
            yield f"{said} does nothing beside skeleton.method, which replaces it"
        else:
            wanted = old.get("graph.method", old.get("contract.preset", "paper"))
            contraction = old.get("contract.method", "slbc")
            skeleton["method"] = contraction if wanted in ("mst", "paper") else "limbs"
            yield f"{said} is now skeleton.method: {skeleton['method']}"
    for key, value in moved.items():
        if value is not None:  # null was the method's own constant
            name = key.removeprefix("contract.")
            yield f"{key} is now skeleton.{name}"
            skeleton.setdefault(name, value)


def _taken(config: MutableMapping, section: str, names: Iterable[str]) -> dict:
    """The values of those keys of a section that are there, which are taken out, by dotted key."""
    there = config.get(section)
    place = there if isinstance(there, MutableMapping) else {}
    return {f"{section}.{name}": place.pop(name) for name in names if name in place}
