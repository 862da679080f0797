"""What the benchmark asks of traits: their truth, the unit it is told in, and the error allowed.

Traits of a whole tree are rows of `cherrypicker.traits.table.TRAITS`, the others columns of
``branches.csv``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cherrypicker.geometry.hulls import hull_of
from cherrypicker.traits.measure import TraitOptions
from cherrypicker.traits.scaffold import Scaffold
from cherrypicker.traits.table import TRAITS
from cherrypicker_lab.orchard.truth import tree_traits


@dataclass(frozen=True)
class Judged:
    """How a trait is judged."""

    # words, unit: its name in tables, and the unit there
    words: str
    unit: str
    factor: float  # from metres, or degrees, to that unit
    bar: float | None = None  # largest MAE asked for, in that unit
    # From a `growth.Tree`; None for columns of ``branches.csv``, whose truth is what `branch_rows`
    # says of the true skeleton
    truth: Callable | None = None
    is_share: bool = False  # told as a share of the truth, in per cent


def true_scaffold(skeleton):
    """The stem and the limbs of a true skeleton."""
    return Scaffold(skeleton, least=TraitOptions().min_limb_m)


def _true_ratio(tree):
    """Sum of the limbs' sections over the stem's, by the generator's radii."""
    limbs = true_scaffold(tree.skeleton()).limbs
    stem = tree_traits(tree)["trunk_diameter_m"]
    return sum(limb.diameter**2 for limb in limbs) / stem**2


def true_volume(skeleton):
    """Volume of the convex hull of the wood's surface beyond the stem's lowest limb."""
    height, turn = np.radians(np.mgrid[-90:91:30, 0:360:30].reshape(2, -1))
    around = np.column_stack(
        [np.cos(height) * np.cos(turn), np.cos(height) * np.sin(turn), np.sin(height)]
    )
    rows = ~true_scaffold(skeleton).clear_stem()
    if not rows.any():
        return 0.0
    surface = skeleton.points[rows, None] + skeleton.radius[rows, None, None] * around
    return hull_of(surface.reshape(-1, 3)).volume


def _whole(name, unit, factor, bar=None, *, words="", truth=None, is_share=False):
    """A trait of a whole tree; its truth is the generator's where nothing else is given."""
    words, truth = words or TRAITS[name].title.lower(), truth or (lambda t: tree_traits(t)[name])
    return name, Judged(words, unit, factor, bar, truth, is_share)


#: Trait to how it is judged, in the order of the tables.
JUDGED = dict(
    [
        _whole("trunk_diameter_m", "mm", 1e3, 3.0),
        ("base_diameter_m", Judged("branch diameter, 10 mm and more", "mm", 1e3, 4.0)),
        _whole("height_m", "cm", 1e2, 2.0),
        ("insertion_angle_deg", Judged("insertion angle", "deg", 1.0, 6.0)),
        _whole("crown_width_m", "cm", 1e2),
        _whole("crown_volume_m3", "dm3", 1e3, truth=lambda t: true_volume(t.skeleton())),
        _whole("total_length_m", "m", 1.0, words="total length"),
        _whole("limb_trunk_ratio", "%", 1e2, 10.0, truth=_true_ratio, is_share=True),
    ]
)
#: Those of a whole tree.
SCALARS = tuple(name for name, judged in JUDGED.items() if judged.truth)
