"""Chains of rings become tubes that claim their points.

The heaviest way through the forest of rings comes first, its side ways after it. A chain becomes a
limb by what no tube has claimed before it: what lies inside a limb's tube or on its surface is that
limb, so that strands beside one another and whiskers on the bark never start.
"""

import logging
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from cherrypicker.errors import StageError
from cherrypicker.geometry.neighbors import Cells, Neighbors
from cherrypicker.geometry.robust import TUKEY, robust_sigma, weighted_median
from cherrypicker.geometry.tree_walks import chains_of
from cherrypicker.limbs.contacts import join_at_contacts
from cherrypicker.limbs.evidence import N_BUMP, N_TOGETHER, design_effect, told_until
from cherrypicker.limbs.joints import back_to
from cherrypicker.limbs.rings import BAND, REACH, Ways, ring_forest, ways_over_wood
from cherrypicker.limbs.tubes import (
    LEAST_COVER,
    ROUGHNESS,
    Limb,
    Seen,
    Tube,
    claim_radius,
    covered,
    even,
    fit_tube,
    seen_from,
    stretch,
    tube_through,
)

logger = logging.getLogger(__name__)

NEIGHBOR = 2  # whose median distance is the spacing of a cloud
NOISE_SHARE = 0.3  # of the spacing: the noise before any limb has told it
LEAST_NOISE = 0.1  # of the spacing: what a perfect cloud is taken to have
FREE_SHARE = 0.5  # of a ring's points that no tube has claimed, for the ring to be free
CAPTURE = 2.0  # in spacings from the surface: where a fit looks for its points
# Points between two nodes of an axis that tell as much as more would, while limbs grow: a tube that
# follows all of them reaches into its neighbours. Of 1, 2.5, 5, 10 and all on six trees of the
# paper's set fewer find more twigs and lose ways; 22 clouds from photos say the same (2026-11-29)
ENOUGH = 5.0
SURE_RADIUS = 4.0  # in noises: a limb at least this thick tells the noise
# Share of the points on limbs thick enough to tell their noise, the thinnest of them, whose noise
# thinner wood is given (guess)
THINNEST = 0.25
# Pixels by which points of thin wood scatter: 0.69 to 0.87 in five scans of two generators, 1.0 to
# 1.3 in a sixth, far from its cameras and under a net (2026-11-27)
SCATTER_PX = 0.75
LEAST_POINTS = 4


@dataclass
class _Met:
    """What the tube of a run met: what bears it, the points around it, and what these tell."""

    parent: int
    near: np.ndarray  # rows of the points around it
    n_free: int  # of them that no tube had claimed
    noise: tuple[float, int] | None = None  # and by how many points; of thick tubes
    effect: tuple[float, int] | None = None


@dataclass
class Limbs:
    """The limbs of a tree, and which point belongs to which."""

    limbs: list[Limb]  # parents before children, the stem first
    member: np.ndarray  # (n_points,) int64: limb whose surface is the nearest to each point
    spacing: float  # of the points
    noise: float  # standard deviation of the points around the surface of thick wood
    claimed: float  # share of the points that lie inside a limb or near its surface

    def report(self) -> dict[str, float]:
        """What a stage writes down of them."""
        return {
            "n_limbs": len(self.limbs),
            "spacing": round(self.spacing, 6),
            "noise": round(self.noise, 6),
            "claimed": round(self.claimed, 4),
        }


def grow_limbs(
    points: np.ndarray,
    base: npt.ArrayLike,
    *,
    stem: np.ndarray | None = None,
    stem_gap: float = np.inf,
    count: np.ndarray | None = None,
    pixel: float | None = None,
) -> Limbs:
    """The limbs of one tree; a `StageError` where its points make none.

    Points (n_points, 3) are its wood, thinned evenly, z up; the base (3,) is the middle of the
    stem's lowest end. `stem`, (n_points,) bool, and its gap are as of `ways_over_wood`. A point
    stands for `count` (n_points,) of the whole cloud: of wood for as many as of what bears it. In a
    cloud from photos `pixel` is the size of a photo's pixel at the tree.
    """
    base = np.asarray(base, dtype=np.float64)
    points = np.asarray(points, dtype=np.float64) - base  # far-off frames would cost digits
    near = Neighbors(points, N_TOGETHER - 1)
    spacing = near.spacing(NEIGHBOR) if len(points) >= LEAST_POINTS else 0.0
    if spacing > 0:
        ways = ways_over_wood(points, near, spacing, stem, stem_gap)
        growth = _Growth(points, ways, near, spacing, count, pixel)
        while growth.add_limbs():  # until the fitted tubes leave none
            pass
        if growth.limbs:
            return growth.finish(base)
    raise StageError(
        f"{len(points)} points make no limb", key="contract.classes, contract.voxel_size_m"
    )


class _Growth:
    """Limbs as they grow: which points are taken, and the noise so far."""

    def __init__(
        self,
        points: np.ndarray,
        ways: Ways,
        near: Neighbors,
        spacing: float,
        count: np.ndarray | None,
        pixel: float | None,
    ) -> None:
        self.points, self.spacing, self.pixel = points, spacing, pixel
        self.reach, self.capture = REACH * spacing, CAPTURE * spacing
        self.ways = ways
        self.cells = Cells(points, self.reach)
        self.weight = np.ones(len(points))
        if count is not None:
            self.weight = np.minimum(count / count[near.index].mean(axis=1), 1.0)
        self.owner = np.full(len(points), -1, dtype=np.int64)
        # Of each point the nearest limb and the next, and how far their surfaces are
        self.nearest, self.off = np.full((2, len(points)), -1), np.full((2, len(points)), np.inf)
        self.limbs: list[Limb] = []
        # What each limb so far tells, and by how many points: the noise of thick ones, and how many
        # points tell as much as one
        self.noises: list[tuple[float, int]] = []
        self.effects: list[tuple[float, int]] = []
        self.noise, self.effect = NOISE_SHARE * spacing, 1.0
        self.n_rival = N_BUMP
        # Runs that are no limbs, by their points. Noise comes up again in each round: a run that
        # meets what it met before is fitted once
        self.failed: dict[bytes, _Met] = {}

    def add_limbs(self) -> bool:
        """Make limbs of all that no tube claims, and fit all limbs anew.

        Returns whether there are more of them, or fewer points tell as much as one.

        A tube that grew between two twigs claimed both; fitted to what is nearest, it leaves one.
        Of all else that fitted tubes leave the most is noise, from which the next have to be told.
        """
        n_before, effect = len(self.limbs), self.effect
        self.failed.clear()
        while self._add_round():  # what no tube claims tells the next
            pass
        if len(self.limbs) == n_before:
            return False
        self._settle()
        self.owner[:] = -1
        for number, limb in enumerate(self.limbs):
            inside, _ = self._near(limb.tube, self.spacing, ROUGHNESS)
            self.owner[inside] = number
        self._enter_all()
        self.n_rival = 0
        return len(self.limbs) > n_before or round(self.effect) < round(effect)

    def _add_round(self) -> bool:
        """Cut what no tube has claimed into rings, and make limbs of their chains; whether of any.

        In a band of all wood the points of a short limb beside its parent are one ring with it. A
        single ring tells no heading.
        """
        rows = np.flatnonzero(self.owner < 0)
        if not len(rows):
            return False
        self.forest, n_before = ring_forest(self.ways, rows), len(self.limbs)
        size = self.forest.size
        runs = [chain for chain in chains_of(self.forest.parent, size) if len(chain) > 1]
        while runs:
            chain = runs.pop(0)
            is_free = self.owner[np.concatenate([self.forest.rows[ring] for ring in chain])] < 0
            starts = np.cumsum(size[chain]) - size[chain]
            free = np.add.reduceat(is_free, starts, dtype=int) > FREE_SHARE * size[chain]
            change = np.flatnonzero(np.diff(free.astype(int), prepend=0, append=0))
            parts = [chain[start:end] for start, end in zip(change[::2], change[1::2])]
            parts = sorted((run for run in parts if len(run) > 1), key=len, reverse=True)
            runs[:0] = parts[1:]
            if parts:
                self.add(parts[0])
        return len(self.limbs) > n_before

    def free(self, rows: np.ndarray) -> np.ndarray:
        """Those of the points that no tube has claimed."""
        return rows[self.owner[rows] < 0]

    def add(self, run: np.ndarray) -> None:
        """Make a limb of a run of rings, if it is one, and let it claim its points."""
        rings = [self.free(self.forest.rows[ring]) for ring in run]
        own = np.concatenate(rings)
        if len(own) < LEAST_POINTS:
            return
        # The limb that most ways from its first ring to the foot meet first
        at = self.forest.rows[run[0]]
        while (self.owner[at[at >= 0]] < 0).any():
            at = np.where((at >= 0) & (self.owner[at] < 0), self.ways.before[at], at)
        owners = self.owner[at[at >= 0]]
        parent = int(np.bincount(owners).argmax()) if len(owners) else -1
        key = own.tobytes()
        met = self.failed.get(key)
        if met and met.parent == parent and len(self.free(met.near)) == met.n_free:
            self._learn(met)
            return
        middle = tube_through([self.points[ring] for ring in rings], BAND * self.spacing)
        if not middle.length:
            return
        tube, met = self._fitted(even(middle, self.spacing), own, parent)
        self._learn(met)
        if parent >= 0:
            tube = back_to(self.limbs[parent].tube, tube, self.spacing)
        inside, seen = self._near(tube, self.spacing, ROUGHNESS)
        is_free = self.owner[inside] < 0
        inside, way = inside[is_free], seen.way[is_free]
        if parent >= 0:
            bearer, beside = self.limbs[parent].tube, self.off[0, inside]
            told = way <= self._told_until(tube, bearer, inside, beside, self.n_rival)
            inside, way = inside[told], way[told]
        start = way.min(initial=np.inf) if parent < 0 else 0.0
        if len(inside) < LEAST_POINTS or way.max() <= start:
            self.failed[key] = met
            return
        self.owner[inside] = len(self.limbs)
        tube = stretch(tube, start, way.max())  # an axis ends where its points do
        self.limbs.append(Limb(tube, max(parent, 0) if self.limbs else -1))
        self._enter(len(self.limbs) - 1)

    def _learn(self, met: _Met) -> None:
        """Add what a tube's points tell to what is known of the noise."""
        if met.noise:
            self.noises.append(met.noise)
            noise = weighted_median(*zip(*self.noises, strict=True))
            self.noise = max(noise, LEAST_NOISE * self.spacing)
        if met.effect:
            self.effects.append(met.effect)
            self.effect = weighted_median(*zip(*self.effects, strict=True))

    def finish(self, base: np.ndarray) -> Limbs:
        """All limbs once more, each by the points to whose surface it is the nearest."""
        claimed = float(np.mean(self.owner >= 0))
        self.limbs = join_at_contacts(self.limbs, self.spacing)
        self._settle()
        thin = None if self.pixel is None else SCATTER_PX * self.pixel
        member = self._refit(thin, is_last=True)
        # Inside its parent, and a spacing around it, a limb has no surface of its own
        for limb in self.limbs[1:]:
            tube = limb.tube
            out, way = _way_out(tube.nodes, self.limbs[limb.parent].tube), tube.way
            inside = np.flatnonzero(out <= 0)
            start = inside[-1] if len(inside) else 0  # from there it leaves it for good
            clear = start + np.flatnonzero(out[start:] > self.spacing)
            if len(clear) and clear[0] > 0:
                last, first = clear[0] - 1, clear[0]
                share = (self.spacing - out[last]) / (out[first] - out[last])
                leaves = way[last] + share * (way[first] - way[last])
                limb.tube = stretch(tube, leaves, tube.length)
        for limb in self.limbs:
            limb.tube = Tube(limb.tube.nodes + base, limb.tube.radius)
        logger.info(
            f"{len(self.limbs)} limbs from {len(self.points):,} points {1e3 * self.spacing:.1f} mm "
            f"apart, noise {1e3 * self.noise:.1f} mm, {100 * claimed:.1f} % of the points claimed"
        )
        return Limbs(self.limbs, member, self.spacing, self.noise, claimed)

    def _settle(self) -> None:
        """Fit the limbs until all are told by their points."""
        while self._drop_hidden(self._refit()):  # a fit to fewer may end inside its parent
            pass

    def _refit(self, of_thin: float | None = None, *, is_last: bool = False) -> np.ndarray:
        """Fit each limb to its points, whose noise on thin wood may be known; whose each point is.

        Nodes begin evenly apart: one that lies aside is held the less the farther it goes, and the
        many fits until all limbs are settled would carry it off. The stem's stay: those of its foot
        are a radius apart, and others between them would take in what stands on it.

        A twig fitted with too much noise comes out too thin, with too little too thick. The last
        fit, to limbs that are settled, takes all points. The outermost of them, at which an axis
        ends, lies beyond the tip by about their noise.
        """
        member = self._nearest_limbs()
        rows_of = [np.flatnonzero(member == number) for number in range(len(self.limbs))]
        of_thin = self._noise_of_thin(rows_of) if of_thin is None else of_thin
        for limb, rows in zip(self.limbs, rows_of, strict=True):
            if len(rows) >= LEAST_POINTS:
                is_sure = np.median(limb.tube.radius) > SURE_RADIUS * max(self.noise, of_thin)
                own, enough = self.noise if is_sure else of_thin, np.inf if is_last else ENOUGH
                tube = limb.tube if limb.parent < 0 else even(limb.tube, self.spacing)
                tube = self._fit(tube, rows, own, self.capture, limb.parent, enough)[0]
                is_cut = is_last and tube.length > own
                limb.tube = stretch(tube, 0.0, tube.length - own) if is_cut else tube
        return member

    def _noise_of_thin(self, rows_of: list[np.ndarray]) -> float:
        """The noise of wood too thin to tell its own: that of the thinnest wood that does, if less.

        Bark and sections that are no circles make thick wood seem noisier than twigs are.
        """
        residual, radius = [np.empty(0)], [np.empty(0)]
        for limb, rows in zip(self.limbs, rows_of, strict=True):
            seen = seen_from(limb.tube, self.points[rows])
            off = seen.away - seen.radius
            sure = (np.abs(off) < self.capture) & (seen.beyond == 0)
            sure &= seen.radius > SURE_RADIUS * self.noise
            residual.append(off[sure])
            radius.append(seen.radius[sure])
        off, by_radius = np.concatenate(residual), np.argsort(np.concatenate(radius))
        thinnest = by_radius[: int(THINNEST * len(off))]
        if len(thinnest) < LEAST_POINTS:
            return self.noise
        return min(self.noise, max(robust_sigma(off[thinnest]), LEAST_NOISE * self.spacing))

    def _drop_hidden(self, member: np.ndarray) -> bool:
        """Drop what their points no longer tell, children move up; whether there was any.

        A limb is told from those beside it as well, but for what it bears itself and what has just
        been dropped. What bears others is told up to where the last leaves it: these would hang on
        nothing. A limb that lies within its parent has borne what the parent bears.
        """
        parents = np.array([limb.parent for limb in self.limbs])
        told = np.full(len(self.limbs), np.inf)
        for number, limb in enumerate(self.limbs[1:], start=1):
            rows = np.flatnonzero(member == number)
            other = self.nearest[1, rows]
            is_own = (parents[other] == number) | (other == limb.parent) | (told[other] <= 0)
            beside = np.where(is_own, np.inf, self.off[1, rows])
            told[number] = self._told_until(limb.tube, self.limbs[limb.parent].tube, rows, beside)
        for number in range(len(self.limbs) - 1, 0, -1):
            if told[number] > 0:
                parent, start = parents[number], self.limbs[number].tube.nodes[:1]
                while told[parent] < 0:
                    parent = parents[parent]
                leaves = float(seen_from(self.limbs[parent].tube, start).way[0])
                told[parent] = max(told[parent], leaves)
        moved, kept, is_changed = {-1: -1}, list[Limb](), False
        for number, limb in enumerate(self.limbs):
            limb.parent = moved[limb.parent]
            is_cut = told[number] < limb.tube.length - self.reach
            is_changed |= is_cut or told[number] <= 0
            if told[number] <= 0:
                moved[number] = limb.parent
                continue
            if is_cut:
                limb.tube = stretch(limb.tube, 0.0, told[number])
            moved[number] = len(kept)
            kept.append(limb)
        self.limbs = kept
        return is_changed

    def _told_until(
        self, tube: Tube, parent: Tube, rows: np.ndarray, beside: np.ndarray, n_rival: int = N_BUMP
    ) -> float:
        """How far its points tell a limb; infinitely less where it ends in its parent's claim."""
        claim = Tube(parent.nodes, claim_radius(parent.radius, self.spacing))
        if _way_out(tube.nodes[-1:], claim)[0] <= 0:
            return -np.inf
        points, weight = self.points[rows], self.weight[rows]
        known = (weight, self.noise, self.effect, self.reach, n_rival, beside)
        return told_until(points, tube, parent, *known, from_photos=self.pixel is not None)

    def _fit(
        self,
        tube: Tube,
        rows: np.ndarray,
        noise: float,
        cutoff: float,
        parent: int = -1,
        enough: float = ENOUGH,
    ) -> tuple[Tube, np.ndarray]:
        """`fit_tube` to some of the points; thicker than the parent only where they cover it."""
        points, scales = self.points[rows], (noise, self.spacing, cutoff, enough)
        fitted, residual = fit_tube(points, tube, *scales)
        if parent >= 0:
            widest = float(seen_from(self.limbs[parent].tube, tube.nodes[:1]).radius[0])
            is_thicker = fitted.radius.max() > widest
            if is_thicker and covered(points, fitted, self.spacing, cutoff) < LEAST_COVER:
                return fit_tube(points, tube, *scales, widest)
        return fitted, residual

    def _fitted(self, tube: Tube, own: np.ndarray, parent: int) -> tuple[Tube, _Met]:
        """The tube of a run: first by its own points, then by all free points around it."""
        capture = self.capture
        cutoff = max(capture, float(np.median(tube.radius)))
        tube = even(self._fit(tube, own, self.noise, cutoff)[0], self.spacing)
        near = self._near(tube, capture)[0]
        around = self.free(near)
        met = _Met(parent, near, len(around))
        if len(around) < LEAST_POINTS:
            return tube, met
        tube, residual = self._fit(tube, around, self.noise, capture, parent)
        beside = np.abs(residual) < capture
        spread = robust_sigma(residual[beside]) if beside.any() else 0.0
        if spread > 0:
            if np.median(tube.radius) > SURE_RADIUS * self.noise:
                met.noise = spread, int(np.count_nonzero(beside))
            sure = np.abs(residual) < TUKEY * spread
            effect = design_effect(self.points[around][sure], residual[sure])
            met.effect = effect, int(np.count_nonzero(sure))
        return tube, met

    def _near(self, tube: Tube, margin: float, in_radii: float = 0.0) -> tuple[np.ndarray, Seen]:
        """Rows of the points in a tube or within a margin of its surface, and as seen from it."""
        step = np.linalg.norm(np.diff(tube.nodes, axis=0), axis=1).max()
        reach = np.hypot((1 + in_radii) * tube.radius + margin, step / 2)
        rows = self.cells.around(tube.nodes, reach)
        seen = seen_from(tube, self.points[rows])
        beside = margin + in_radii * seen.radius
        near = (seen.away <= seen.radius + beside) & (seen.beyond <= beside)
        return rows[near], Seen(*(values[near] for values in seen))

    def _enter_all(self) -> None:
        """Enter the limbs as they are now, and none that were."""
        self.nearest[:], self.off[:] = -1, np.inf
        for number in range(len(self.limbs)):
            self._enter(number)

    def _enter(self, number: int) -> None:
        """Enter a limb at the points to which it is the nearest or the next."""
        rows, seen = self._near(self.limbs[number].tube, self.capture)
        off = np.hypot(seen.away - seen.radius, seen.beyond)
        is_first = off < self.off[0, rows]
        first = rows[is_first]
        self.nearest[1, first], self.off[1, first] = self.nearest[0, first], self.off[0, first]
        is_next = ~is_first & (off < self.off[1, rows])
        for place, which in enumerate((is_first, is_next)):
            self.nearest[place, rows[which]], self.off[place, rows[which]] = number, off[which]

    def _nearest_limbs(self) -> np.ndarray:
        """Limb whose surface is the nearest to each point."""
        self._enter_all()
        member = self.nearest[0].copy()
        rest = np.flatnonzero(member < 0)
        nodes = np.vstack([limb.tube.nodes for limb in self.limbs])
        ends = np.cumsum([len(limb.tube.nodes) for limb in self.limbs])
        nearest = cKDTree(nodes).query(self.points[rest])[1]
        member[rest] = np.searchsorted(ends, nearest, side="right")
        return member


def _way_out(nodes: np.ndarray, parent: Tube) -> np.ndarray:
    """How far each node lies outside a parent's surface, infinitely beyond its ends."""
    seen = seen_from(parent, nodes)
    return np.where(seen.beyond == 0, seen.away - seen.radius, np.inf)
