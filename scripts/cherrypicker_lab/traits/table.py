"""True stems, limbs and crowns of skeletons, and how traits are told in the laboratory's tables."""

from typing import NamedTuple

import numpy as np

from cherrypicker.geometry.hulls import hull_of
from cherrypicker.traits.measure import TraitOptions
from cherrypicker.traits.scaffold import Scaffold


class Judged(NamedTuple):
    """How a trait is told in tables."""

    words: str
    unit: str
    factor: float  # from metres, degrees or shares to that unit


def true_scaffold(skeleton):
    """The stem and the limbs of a true skeleton."""
    return Scaffold(skeleton, least=TraitOptions().min_limb_m)


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


#: Trait to how it is told, in the order of the tables.
JUDGED = {
    "trunk_diameter_m": Judged("trunk diameter", "mm", 1e3),
    "base_diameter_m": Judged("branch diameter, 10 mm and more", "mm", 1e3),
    "height_m": Judged("height", "cm", 1e2),
    "insertion_angle_deg": Judged("insertion angle", "deg", 1.0),
    "crown_width_m": Judged("crown width", "cm", 1e2),
    "crown_volume_m3": Judged("crown volume", "dm3", 1e3),
    "total_length_m": Judged("total length", "m", 1.0),
    "limb_trunk_ratio": Judged("limb-to-trunk ratio", "%", 1e2),
}
