"""Errors as independent terms, each a factor times something that was measured.

A fit tells the standard error of its own. What it cannot see (photogrammetry moves whole surfaces,
the contraction bends whole stretches) follows quantities that the scan knows: the scatter of
points, the distance at which they have company. What an error is of such a quantity is a factor of
``interval_factors.yaml``, fitted to trees whose truth is known.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cherrypicker.files import load_yaml
from cherrypicker.geometry.sections import Section

FACTORS_FILE = Path(__file__).with_name("interval_factors.yaml")
#: Name to value; what each multiplies and was fitted on stands in the file.
FACTORS: dict[str, float] = {
    name: entry["value"] for name, entry in load_yaml(FACTORS_FILE).items()
}
#: Name of a factor to what it multiplies, in the unit of what errs; ``fit`` and ``scale`` are
#: standard errors that a fit and the markers tell, and need no factor.
Terms = Mapping[str, float | np.ndarray]
KNOWN = ("fit", "scale")


def spread(terms: Terms) -> float | np.ndarray:
    """Standard deviation of an error, the root of the sum of its terms' squares."""
    parts = [(1.0 if name in KNOWN else FACTORS[name]) * term for name, term in terms.items()]
    return np.sqrt(sum(part**2 for part in parts))


def trunk_terms(section: Section) -> dict[str, float]:
    """What the error of a trunk's diameter follows, by its section.

    Photogrammetry moves a whole surface outwards or inwards by a part of the scatter that it shows,
    and a smooth one is off by a part of its diameter all the same; no fit sees that.
    """
    return {
        "fit": 2.0 * section.error,
        "trunk_shared": section.noise,
        "trunk_hidden": 2.0 * section.radius,
    }
