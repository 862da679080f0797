"""One scale from several known lengths: weighted, with one that disagrees left out and named.

Every reference gives a scale with its relative standard errors. They are joined by their inverse
variance in the logarithm of the scale. Each is also held against what the others give without it:
that difference is the check that scale.json and the report show.
"""

import numpy as np

from cherrypicker.errors import StageError

# Two correct references differ by no more than this many of their errors (guess)
MOST_ERRORS = 3.0
_WORST_DISAGREEMENT = 0.03  # of two references that the scale survives (guess)


def combine(references: list[dict], warnings: list[str]) -> tuple[float, float]:
    """Scale by all references, and its error; changes their ``used``, ``flags`` and ``check``.

    A reference has ``name``, ``key`` (to change), ``used``, ``flags`` and, where used, ``scale``,
    ``scale_std`` and ``slack``: how far its length may be off beyond that, relative. The slack
    tells references apart and weighs them, but is no part of the scale's own error. ``warnings``
    get a line for each that is left out or in doubt.

    Raises
    ------
    StageError
        If none is usable, or if two contradict each other and nothing says which is right.
    """
    used = [one for one in references if one["used"]]
    if not used:
        reasons = "; ".join(f"{one['name']}: {', '.join(one['flags'])}" for one in references)
        raise StageError(f"no reference gives a scale ({reasons})", key=_keys(references))
    while len(used) > 1:
        checks = [_check(one, used) for one in used]
        off = [abs(check["difference"]) for check in checks]
        errors = np.array(off) / [check["difference_std"] for check in checks]
        worst = int(np.argmax(errors))
        if errors[worst] <= MOST_ERRORS:
            break
        if len(used) == 2:
            text = " and ".join(f"{one['name']} ({one['scale']:.5g} m a unit)" for one in used)
            message = f"{text} contradict each other by {100 * off[0]:.1f} %"
            if off[0] > _WORST_DISAGREEMENT:
                raise StageError(f"{message}; check their lengths", key=_keys(used))
            for one in used:
                one["flags"].append(f"in doubt: {message}")
            warnings.append(f"{message}, check {_keys(used)}")
            break
        percent = f"{100 * checks[worst]['difference']:+.1f} %"
        drop(used.pop(worst), f"it differs by {percent} from the scale of the others", warnings)
    value, error, _ = _mean(used)
    for one in references:
        is_checked = one.get("scale") and any(other is not one for other in used)
        one["check"] = _check(one, used) if is_checked else None
    return float(np.exp(value)), float(np.exp(value) * error)


def _mean(used: list[dict]) -> tuple[float, float, float]:
    """Logarithm of the joint scale, its standard error, and that with the lengths' own slack."""
    values = np.log([one["scale"] for one in used])
    stds = np.array([one["scale_std"] / one["scale"] for one in used])
    loose = np.hypot(stds, [one["slack"] for one in used])
    weights = 1 / loose**2 / np.sum(1 / loose**2)
    mean, variance = float(weights @ values), float(weights**2 @ stds**2)
    if len(used) > 1:
        # What they differ by beyond their own errors is part of the uncertainty (Birge's ratio).
        excess = np.sum(((values - mean) / np.maximum(stds, 1e-12)) ** 2) / (len(used) - 1)
        variance *= max(excess, 1.0)
    return mean, float(np.sqrt(variance)), float(np.sqrt(weights**2 @ loose**2))


def _check(one: dict, used: list[dict]) -> dict:
    """How much a reference differs from the others, and the standard error of that."""
    others = [other for other in used if other is not one]
    (own, _, own_loose), (value, _, loose) = _mean([one]), _mean(others)
    return {
        "difference": own - value,
        "difference_std": float(np.hypot(own_loose, loose)),
        "against": [other["name"] for other in others],
    }


def drop(one: dict, reason: str, warnings: list[str]) -> None:
    """Leave a reference out, and say so with the key to look at."""
    one["used"] = False
    one["flags"].append(f"left out: {reason}")
    warnings.append(f"{one['name']} is left out: {reason}; check {one['key']}")


def _keys(references: list[dict]) -> str:
    return ", ".join(dict.fromkeys(one["key"] for one in references))
