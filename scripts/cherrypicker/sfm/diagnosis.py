"""What became of each photo, and why some are missing from the model."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
import pycolmap

from cherrypicker.sfm.database import feature_counts

# Features below which a photo counts as blurred or blank, and as a share of the median (guesses)
FEW_FEATURES = 200
FEW_SHARE = 0.1


def diagnose_photos(
    database: Path,
    listing: dict,
    model: pycolmap.Reconstruction | None,
    other_models: Sequence[Sequence[str]] = (),
    *,
    min_inliers: int,
) -> dict[str, dict]:
    """Explain each photo of the folder.

    Parameters
    ----------
    database : Path
        Database with verified matches.
    listing : dict
        What :func:`cherrypicker.sfm.features.extract_features` listed.
    model : pycolmap.Reconstruction or None
        The model that was kept.
    other_models : sequence of sequence of str
        Photo names of the models that were not.
    min_inliers : int
        Least matches of a verified pair.

    Returns
    -------
    dict
        By photo name: ``registered``, ``reason`` (empty for a registered photo), ``n_features``,
        ``n_partners`` (photos it has a verified pair with), ``n_matches`` (over those pairs),
        ``best_partner`` and ``best_matches``, ``n_points`` seen in the model.
    """
    counts = feature_counts(database)
    inliers = verified_inliers(database, min_inliers)
    registered = {}
    if model is not None:
        registered = {im.name: im.num_points3D for im in model.images.values() if im.has_pose}
    report = {}
    for name, info in sorted(listing["photos"].items()):
        partners = inliers.get(name, {})
        best = max(partners, key=lambda each: (partners[each], each), default="")
        report[name] = {
            "registered": name in registered,
            "reason": "",
            "n_features": counts.get(name, 0),
            "n_partners": len(partners),
            "n_matches": sum(partners.values()),
            "best_partner": best,
            "best_matches": partners.get(best, 0),
            "n_points": registered.get(name, 0),
            "exif_orientation": info["exif_orientation"],
        }
        if name not in registered:
            report[name]["reason"] = info["problem"] or _reason(
                name,
                report[name],
                registered,
                other_models,
                float(np.median(list(counts.values()))),
            )
    return report


def verified_inliers(database: Path, min_inliers: int) -> dict[str, dict[str, int]]:
    """Return, by photo, the photos it has a verified pair with and the matches of each pair."""
    result: dict[str, dict[str, int]] = {}
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: image.name for image in opened.read_all_images()}
        pair_ids, n_inliers = opened.read_two_view_geometry_num_inliers()
        for pair_id, n in zip(pair_ids, n_inliers):
            if n < min_inliers:
                continue
            first, second = (names[i] for i in pycolmap.pair_id_to_image_pair(pair_id))
            result.setdefault(first, {})[second] = int(n)
            result.setdefault(second, {})[first] = int(n)
    return result


def _reason(
    name: str,
    facts: dict,
    registered: Collection[str],
    other_models: Sequence[Sequence[str]],
    median_features: float,
) -> str:
    n_features = facts["n_features"]
    few = n_features < max(FEW_FEATURES, FEW_SHARE * median_features)
    hint = f" ({n_features} features; median {median_features:.0f}: blurred or blank?)"
    if few and not facts["n_partners"]:
        return f"too few features{hint}"
    if not facts["n_partners"]:
        return "no match: no other photo shows the same points" + (hint if few else "")
    for i, names in enumerate(other_models, start=2):
        if name in names:
            return f"in a separate model (number {i}, {len(names)} photos) that nothing joins"
    if facts["best_partner"] not in registered:
        return (
            f"matches only {facts['n_partners']} photo(s), the best of which "
            f"({facts['best_partner']}, {facts['best_matches']} matches) is not in the model"
        )
    return (
        f"matched but not registered: {facts['n_partners']} photo(s), best "
        f"{facts['best_partner']} with {facts['best_matches']} matches"
    )
