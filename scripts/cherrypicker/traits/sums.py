"""Numbers, lengths and volumes over a tree's axes, and how sure they are.

The fewer points an axis has, the more it is luck that it was found. For each one that was found
with a chance p there are 1 / p (Horvitz and Thompson, Journal of the American Statistical
Association 47:663-685, 1952), and of axes of n points n / (n + h) are found: those of h points half
of the time. How well axes are found differs from tree to tree, so each draw has an h of its own.
Photos tell besides how likely each axis is there, and how much thin wood lacks.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from cherrypicker.files import rounded
from cherrypicker.geometry.error_terms import FACTORS, Terms
from cherrypicker.traits.intervals import Estimate


def draw_unfound(
    n_points: np.ndarray, p_exists: np.ndarray, n_samples: int, rng: np.random.Generator
) -> np.ndarray:
    """Draw how many more axes like each a tree has than were found, (n_samples, n_axes) int64.

    -1 for one that is none itself: it stands for no others. An axis has ``n_points``, infinitely
    many where it is surely found, and is there with the probability ``p_exists``, (n_axes,) float64
    both.
    """
    half_found = FACTORS["half_found"] * rng.exponential(size=(n_samples, 1))
    missed = rng.geometric(1.0 / (1.0 + half_found / n_points)) - 1
    return np.where(rng.random(missed.shape) < p_exists, missed, -1)


class AxisSums:
    """Sums over axes, the rows of ``branches.csv``.

    How many of each were not found is drawn by `draw_unfound`. ``lacking`` is the length of the
    thin wood that photos show and the skeleton lacks. The points scatter around the skeleton's
    radii by ``scatter``, None where it is not known. ``scale_error`` is the relative standard error
    of the scan's scale.
    """

    def __init__(
        self,
        rows: Sequence[Mapping],
        unfound: np.ndarray,
        lacking: float,
        scatter: float | None,
        scale_error: float,
    ) -> None:
        names = ("order", "length_m", "volume_m3", "mean_diameter_m")
        self.order, self._length, self._volume, self._diameter = (
            np.array([row[name] for row in rows]) for name in names
        )
        of_sides = float(self._length[self.order > 0].sum())
        self._unfound, self._lacking = unfound, lacking / max(of_sides, 1e-12)  # of each a share
        self._scatter, self._scale_error = scatter or 0.0, scale_error

    def _sum(self, each: np.ndarray, terms: Terms, power: int, missing: float = 0.0) -> Estimate:
        drawn, scale = self._unfound @ each, power * self._scale_error
        return Estimate.of(each.sum().item(), terms, drawn, missing, scale=scale)

    def number(self, own: np.ndarray | bool = True) -> Estimate:
        """How many axes there are, of all or of some, (n_axes,) bool: the trunk is one."""
        each = own * np.ones(len(self.order), dtype=np.int64)
        n_side = float(each[self.order > 0].sum())
        terms = {"count_share": n_side} if each.any() else {}
        return self._sum(each, terms, 0, self._lacking * n_side)

    def length(self, own: np.ndarray | bool = True) -> Estimate:
        """Length of the same."""
        each = own * self._length
        missing = self._lacking * float(each[self.order > 0].sum())
        return self._sum(each, {"length_share": float(each.sum())}, 1, missing)

    def volume(self, own: np.ndarray | bool = True) -> Estimate:
        """Volume of the same, to which thin wood that lacks adds next to nothing.

        Surfaces that are moved as a whole move all wood alike.
        """
        each = own * self._volume
        surface = 4.0 * float((each / np.maximum(self._diameter, 1e-12)).sum())
        terms = {"volume_shared": self._scatter * surface} if self._scatter else {}
        return self._sum(each, terms, 3)

    def by_order(self) -> dict[str, dict]:
        """What stands in ``traits.json`` of the axes of each order, by the order's number."""
        told: dict[str, dict] = {"mean_diameter_by_order_m": {}}
        for order in np.unique(self.order).tolist():
            own, key = self.order == order, str(order)
            for name, found, digits in (
                ("n_branches_by_order", self.number(own), 6),
                ("length_by_order_m", self.length(own), 6),
                ("volume_by_order_m3", self.volume(own), 8),
            ):
                told.setdefault(name, {})[key] = round(found.value, digits)
                if found.ends is not None:
                    ends = [round(float(end), digits) for end in found.ends]
                    told.setdefault(f"{name}_ci90", {})[key] = ends
            weight = own * self._length
            told["mean_diameter_by_order_m"][key] = rounded(
                weight @ self._diameter / max(weight.sum(), 1e-12)
            )
        return told
