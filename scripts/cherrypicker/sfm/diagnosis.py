"""What became of each photo, and why some are missing from the model."""

from collections.abc import Collection

import numpy as np

from cherrypicker.sfm.database import verified_inliers
from cherrypicker.sfm.export import registered_photos
from cherrypicker.sfm.mapping import Attempt
from cherrypicker.sfm.matching import MIN_INLIERS

# What holds a camera
_HOLD = {"n_features": "features", "n_partners": "partners", "n_matches": "matches"}


def diagnose_photos(attempt: Attempt, listing: dict, *, doubtful_px: float) -> dict[str, dict]:
    """Explain each photo that :func:`cherrypicker.sfm.features.extract_features` listed.

    By the attempt whose model was kept. By photo name: ``registered``, ``reason`` (empty for a
    registered photo), ``doubt`` (empty for one that is known to less than ``doubtful_px``),
    ``error_px`` (None of no camera or one that nothing holds), ``n_features``, ``n_partners``
    (photos it has a verified pair with, of `MIN_INLIERS` or more), ``n_matches`` (over those
    pairs), ``best_partner`` and ``best_matches``, ``n_points`` seen in the model.
    """
    known_px = {**attempt.errors, **attempt.left_out}
    inliers = verified_inliers(attempt.database, MIN_INLIERS)
    registered = {image.name: image.num_points3D for image in registered_photos(attempt.model)}
    report = {}
    for name, info in sorted(listing["photos"].items()):
        partners = inliers.get(name, {})
        best = max(partners, key=lambda each: (partners[each], each), default="")
        report[name] = {
            "registered": name in registered,
            "reason": "",
            "doubt": "",
            "error_px": known_px.get(name) if np.isfinite(known_px.get(name, 0)) else None,
            "n_features": info["n_features"],
            "n_partners": len(partners),
            "n_matches": sum(partners.values()),
            "best_partner": best,
            "best_matches": partners.get(best, 0),
            "n_points": registered.get(name, 0),
            "exif_orientation": info["exif_orientation"],
        }
    sound = [facts for name, facts in report.items() if not listing["photos"][name]["problem"]]
    medians = {key: float(np.median([facts[key] for facts in sound])) for key in _HOLD}
    for name, facts in report.items():
        error, problem = facts["error_px"], listing["photos"][name]["problem"]
        few = [
            f"{facts[key]} {what} (median {medians[key]:.0f})"
            for key, what in _HOLD.items()
            if 2 * facts[key] < medians[key]
        ]
        cause = f"held by only {', '.join(few)}" if few else "the points that hold it disagree"
        known = "held by nothing" if error is None else f"known within {error:.1f} px, {cause}"
        if name in attempt.left_out:
            facts["reason"] = f"left out: its camera is {known}"
        elif name not in registered:
            facts["reason"] = problem or _reason(name, facts, attempt, registered, medians)
        elif error is not None and error > doubtful_px:
            facts["doubt"] = known
    return report


def _reason(
    name: str, facts: dict, attempt: Attempt, registered: Collection[str], medians: dict[str, float]
) -> str:
    n_features, median_features = facts["n_features"], medians["n_features"]
    if not facts["n_partners"] and 2 * n_features < median_features:
        hint = f"{n_features} features; median {median_features:.0f}: blurred or blank?"
        return f"too few features ({hint})"
    if not facts["n_partners"]:
        return "no match: no other photo shows the same points"
    for i, names in enumerate(attempt.other_models, start=2):
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
