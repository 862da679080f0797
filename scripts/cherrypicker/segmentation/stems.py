"""What the limbs of the trees say of the labels: trunk and branch, what lies in a tube, the foot.

A network that looks at points cannot see the border between trunk and branch, which is a matter of
how thick an axis goes on over a fork. The trunk is the axis of order 0 of a tree's joined limbs
(`cherrypicker.skeleton.axes`), and its points are those of the limbs along it. What lies in a tube
is wood, unless more of it is of things, and a stem that ends in the air over ground goes on down.
"""

import logging
from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.geometry.ground_surface import ground_height, ground_level
from cherrypicker.geometry.neighbors import link_components, rows_in_box
from cherrypicker.limbs.growth import Limbs
from cherrypicker.limbs.joints import join_limbs
from cherrypicker.limbs.orchard import Orchard
from cherrypicker.limbs.poles import find_poles, in_cylinder
from cherrypicker.limbs.tubes import Tube, claim_radius, stretch
from cherrypicker.pointcloud import PointCloud
from cherrypicker.segmentation.things import STANDS_M, THINGS, TOUCH_M, loose_wood
from cherrypicker.segmentation.white_rings import STEP_M, ring_points
from cherrypicker.skeleton.axes import TRUNK_KEEPS, TRUNK_SKIP, axes
from cherrypicker.skeleton.model import Skeleton

logger = logging.getLogger(__name__)

# Mean probability of a post, if it is that or wood, of what is as straight and even as a pole: of
# three stems 0.006 to 0.012, of seven posts 0.043 and 0.73 to 0.97 (2026-11-26)
POST_BY_SHAPE = 0.025
MOST = 0.9  # of a thing: below a stem, in its tubes (a guess)
HEADING_IN_RADII = 6.0  # length of a stem's foot that tells where it comes from (a guess)


class _Tubes:
    """The joined tubes of one stem as nodes; the trunk's, from the foot up, are ``stem``.

    It is the axis of order 0, and goes on along its limb while that keeps its thickness: order 0
    ends at the last fork below that place, which may be a diameter lower. Of the arms of a head the
    lowest leaves there, and the stem goes on to the highest.
    """

    def __init__(self, limbs: Limbs) -> None:
        nodes, parent, radius, limb = join_limbs(limbs.limbs, limbs.spacing, STEP_M)
        for number in np.unique(limb)[1:]:  # a stub's tube may be wider than what it grows from
            own = np.flatnonzero(limb == number)
            radius[own] = np.minimum(radius[own], radius[parent[own[0]]])
        self.nodes, self.radius, self.limb = nodes, radius, limb
        self.reach = claim_radius(radius, limbs.spacing)
        skeleton = Skeleton(nodes, parent, radius, np.full(len(nodes), int(Label.BRANCH)))
        trunk = axes(skeleton)[0].nodes
        way, diameter = skeleton.distance_to_root()[trunk], 2 * radius[trunk[-1]]
        below = radius[trunk[way <= way[-1] - TRUNK_SKIP * diameter]]
        if len(below):
            ahead = trunk[-1] + np.flatnonzero(limb[trunk[-1] :] == limb[trunk[-1]])[1:]
            # Tubes are smooth: half of a step lies on either side of it
            thick = radius[ahead] >= (1 + TRUNK_KEEPS) / 2 * below[-1]
            trunk = np.concatenate([trunk, ahead[np.logical_and.accumulate(thick)]])
        self.trunk, self.stem = trunk, Tube(nodes[trunk], radius[trunk])

    def nearest_surface(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether the nearest surface to each point (n, 3) is the trunk's, whether it claims it."""
        off, branch = self._nearest(points, np.delete(np.arange(len(self.nodes)), self.trunk))
        off_trunk, trunk = self._nearest(points, self.trunk)
        return off_trunk < off, np.maximum(branch, trunk) >= 0

    def count(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The limb in whose tube each point (n, 3) lies, -1 in none; how many lie in each."""
        limb = np.append(self.limb, -1)[self._nearest(points, np.arange(len(self.limb)))[1]]
        return limb, np.bincount(1 + limb, minlength=self.limb.max() + 2)[1:]

    def _nearest(self, points: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far the surface at the nearest of some nodes is; that node if it claims, or -1."""
        far = np.nextafter(self.reach.max(), np.inf)
        away, nearest = cKDTree(self.nodes[nodes]).query(points, distance_upper_bound=far)
        node = np.append(nodes, 0)[nearest]  # where none is near, it is infinitely far away
        return np.abs(away - self.radius[node]), np.where(away <= self.reach[node], node, -1)


def limbs_decide(
    cloud: PointCloud,
    grow: Callable[[PointCloud], Orchard],
    *,
    post: np.ndarray,
    known: np.ndarray,
    stem_gap_m: float,
) -> Orchard:
    """Label in place, in a cloud, what its limbs say is post, stem, trunk and branch.

    Points are in metres, z up. `post` (n,) is the network's probability of what is post or wood to
    be post, `known` (n,) whose class is a fact. The limbs are grown anew where they had posts
    beside them, until none is found, or lacked their foot; the last of them are returned.
    """
    labels = cloud["label"]
    said = labels == Label.SUPPORT_POST
    labels[said] = Label.BRANCH  # until its limbs tell
    orchard = grow(cloud)
    while len(posts := poles_and_wires(cloud, orchard, post=post, known=known)):
        labels[posts] = Label.SUPPORT_POST
        orchard = grow(cloud)
    posts, stems = said_posts(cloud, orchard, said)
    labels[said] = labels[posts] = Label.SUPPORT_POST
    labels[stems] = Label.TRUNK
    orchard = grow(cloud) if len(posts) or len(stems) else orchard
    rows, kinds = on_things(cloud, orchard)
    labels[rows] = kinds
    orchard = grow(cloud) if len(rows) else orchard
    stems = under_stems(cloud, orchard, known=known, grow=grow)
    labels[stems] = Label.TRUNK
    orchard = grow(cloud) if len(stems) else orchard
    labels[:] = loose_wood(cloud.points, labels, orchard.owner)
    label_wood(cloud, orchard, known=known, stem_gap_m=stem_gap_m)
    return orchard


def label_wood(
    cloud: PointCloud, orchard: Orchard, *, known: np.ndarray, stem_gap_m: float
) -> None:
    """Let the limbs decide, in place, what is trunk, branch, ring or foot.

    The orchard is grown from the cloud: its owners are told what is found to be wood, and a stem
    that is followed down to the ground, over pieces of at most `stem_gap_m` that nothing shows, has
    a longer limb. No tube claims points (n,) whose class is known. In a cloud with colours white
    rings on the stems become calibration unit. Stems without limbs keep their labels.
    """
    points, labels = cloud.points, cloud["label"]
    is_wood, is_ground = wood_mask(labels), labels == Label.GROUND
    before = labels[is_wood]
    is_free = np.isin(labels, [*THINGS, Label.SUPPORT_POST]) & ~known
    free = np.flatnonzero(is_free | is_ground)
    free_points, ground = points[free], points[is_ground]
    for stem, limbs, _ in _grown(orchard):
        follow_down(free_points, limbs, ground, stem_gap_m)
        tubes = _Tubes(limbs)
        own = np.flatnonzero(is_wood & (orchard.owner == stem))
        labels[own] = np.where(tubes.nearest_surface(points[own])[0], Label.TRUNK, Label.BRANCH)
        inside, in_trunk = claimed_by(tubes, free_points)
        keep = in_trunk | ~is_ground[free[inside]]  # twigs hang into grass
        claimed, in_trunk = free[inside[keep]], in_trunk[keep]
        labels[claimed] = np.where(in_trunk, Label.TRUNK, Label.BRANCH)
        orchard.owner[claimed] = stem
        if cloud.colors is not None:
            label_rings(points, labels, cloud.colors, tubes)
        (x, y), (first, last) = tubes.stem.nodes[0, :2], 1000 * tubes.stem.radius[[0, -1]]
        logger.info(
            f"stem at ({x:.2f}, {y:.2f}): trunk of {tubes.stem.length:.2f} m, radius {first:.1f} "
            f"to {last:.1f} mm; {len(claimed):,} points of other classes lie in its limbs"
        )
    changed = np.count_nonzero(labels[is_wood] != before)
    logger.info("the limbs changed %.1f %% of the wood", 100 * changed / max(is_wood.sum(), 1))


def poles_and_wires(
    cloud: PointCloud, orchard: Orchard, *, post: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """Rows of posts and wires by their shape, among limbs grown on wood and what is said a post.

    Little wood is so straight and even as a pole (`cherrypicker.limbs.poles`): what lies in one
    that stands, and is even for its radius, is post, but for points (n,) whose class is known, for
    one that hardly is a post by the network's probabilities (n,), and for one without which wood
    would hang in the air: that is a stem, unless it is likelier a post. One that ends in the air on
    both sides is a wire.
    """
    points, labels = cloud.points, cloud["label"]
    is_thing, is_limb = np.isin(labels, THINGS) & ~known, wood_mask(labels)
    ground, anything = points[labels == Label.GROUND], np.flatnonzero(is_limb | is_thing)
    everywhere = points[anything]
    found = np.zeros(len(points), bool)
    for stem, limbs, entered in _grown(orchard):
        wood, rows = points[entered], np.flatnonzero((orchard.owner == stem) | is_thing)
        tree, owned = cKDTree(wood), points[rows]
        is_left, posts, in_air = np.ones(len(entered), bool), [], []
        poles = [
            (number, pole)
            for number, limb in enumerate(limbs.limbs)
            for pole in find_poles(wood, limb.tube, limbs.spacing)
        ]
        for number, pole in poles:
            lying = rows[pole.rows(owned)]
            if not len(lying):  # amid things
                continue
            lowest = lying[np.argsort(points[lying, 2])[:1]]
            if not _stands(points[lowest], ground, STANDS_M).any():
                in_air.append((number, pole))
            elif pole.is_even and post[lying].mean() >= POST_BY_SHAPE:
                posts.append(lying)
                is_in, of_limb = np.isin(entered, lying), limbs.member == number
                is_left &= ~is_in & ~(of_limb & (2 * is_in[of_limb].sum() > of_limb.sum()))
        # A wire may end at a post, and hang on its stem as well
        for number, pole in in_air:
            if pole.is_free(wood[is_left]):
                around = anything[pole.halo().rows(everywhere)]
                grown = limbs.member[tree.query(points[around])[1]] == number
                found[np.union1d(anything[pole.rows(everywhere)], around[grown])] = True
        is_stem = bool(posts) and _hang(wood[is_left], ground, TOUCH_M)
        for each in posts:
            found[each] |= not is_stem or post[each].mean() > 0.5
    logger.info(f"{found.sum():,} points are of poles and wires")
    return np.flatnonzero(found)


def said_posts(
    cloud: PointCloud, orchard: Orchard, said: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of posts and of stems among limbs most of whose points are said (n,) to be a post.

    One that bears limbs which would hang in the air without it is a stem.
    """
    points, labels = cloud.points, cloud["label"]
    is_wood, ground = wood_mask(labels) & ~said, points[labels == Label.GROUND]
    posts, stems = [np.empty(0, int)], [np.empty(0, int)]
    for stem, limbs, entered in _grown(orchard):
        n_said = np.bincount(limbs.member, said[entered], len(limbs.limbs))
        is_post = 2 * n_said > np.bincount(limbs.member, minlength=len(limbs.limbs))
        if not is_post.any():
            continue
        bears = np.zeros(len(is_post), bool)
        bears[[limb.parent for limb, post in zip(limbs.limbs, is_post) if not post]] = True
        owned = np.flatnonzero(orchard.owner == stem)
        limb = limbs.member[cKDTree(points[entered]).query(points[owned])[1]]
        left = owned[~is_post[limb] & is_wood[owned]]
        is_stem = is_post & bears & _hang(points[left], ground, STANDS_M)
        stems.append(owned[is_stem[limb]])
        posts.append(entered[(is_post & ~is_stem)[limbs.member]])
    logger.info(f"{sum(map(len, posts)):,} points are of posts by the network's word")
    return np.concatenate(posts), np.concatenate(stems)


def on_things(cloud: PointCloud, orchard: Orchard) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the wood of limbs in whose tubes more is of things than is wood, and their labels.

    Such a limb is grown on what passes for wood of a thing, of a stand for instance.
    """
    points, labels = cloud.points, cloud["label"]
    things, is_wood = np.flatnonzero(np.isin(labels, THINGS)), wood_mask(labels)
    found = [np.empty(0, int)]
    for stem, limbs, _ in _grown(orchard) if len(things) else ():
        tubes, own = _Tubes(limbs), np.flatnonzero(is_wood & (orchard.owner == stem))
        limb, n_wood = tubes.count(points[own])
        n_things = tubes.count(points[things])[1]
        found.append(own[np.append(n_things > n_wood, False)[limb]])
    rows = np.concatenate(found)
    logger.info(f"{len(rows):,} points of wood are of things")
    return rows, labels[things[cKDTree(points[things]).query(points[rows])[1]]]


def _grown(orchard: Orchard) -> Iterator[tuple[int, Limbs, np.ndarray]]:
    """Number, limbs and entered rows of each stem that has limbs."""
    for stem, (limbs, entered) in enumerate(zip(orchard.limbs, orchard.entered, strict=True)):
        if limbs:
            yield stem, limbs, entered


def _stands(feet: np.ndarray, ground: np.ndarray, within: float) -> np.ndarray:
    """Whether each of some feet (n, 3) reaches the ground, or nearly, (n,) bool."""
    return feet[:, 2] - ground_height(feet[:, :2], ground, np.inf) <= within


def _hang(points: np.ndarray, ground: np.ndarray, within: float) -> bool:
    """Whether most of the points (n, 3) hang together with none that stands."""
    piece, order = link_components(points, TOUCH_M), np.argsort(points[:, 2])
    feet = points[order[np.unique(piece[order], return_index=True)[1]]]
    return bool(2 * np.count_nonzero(_stands(feet, ground, within)[piece]) < len(points))


def claimed_by(tubes: _Tubes, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the points (n, 3) that lie in a tube, and whether in the trunk's."""
    ends = [tubes.nodes - tubes.reach[:, None], tubes.nodes + tubes.reach[:, None]]
    rows = rows_in_box(points, ends[0].min(axis=0), ends[1].max(axis=0))
    is_trunk, is_inside = tubes.nearest_surface(points[rows])
    return rows[is_inside], is_trunk[is_inside]


def _over_ground(limbs: Limbs, ground: np.ndarray) -> float:
    """How far a stem's foot is over the ground, or 0: within its spacing, or nothing is known."""
    tube = limbs.limbs[0].tube
    level = ground_level(ground, tube.nodes[0, :2], float(tube.radius[0]))
    gap = 0.0 if level is None else float(tube.nodes[0, 2] - level)
    return gap if abs(gap) > limbs.spacing else 0.0


def under_stems(
    cloud: PointCloud, orchard: Orchard, *, known: np.ndarray, grow: Callable[[PointCloud], Orchard]
) -> np.ndarray:
    """Rows of the things that are the foot of a stem which else hangs in the air.

    Things that lie around under such a stem as a whole are grown along with the wood: of one that
    is a stem most points lie in the tubes of the tree that hung, of a board or a sign with its post
    they do not.
    """
    points, labels = cloud.points, cloud["label"]
    ground, free = points[labels == Label.GROUND], np.flatnonzero(np.isin(labels, THINGS) & ~known)
    is_below, hanging = np.zeros(len(free), bool), []
    for stem, limbs, _ in _grown(orchard):
        if (gap := _over_ground(limbs, ground)) > TOUCH_M:
            foot, wide = limbs.limbs[0].tube.nodes[0], gap + STANDS_M
            box = foot - wide, foot + [wide, wide, TOUCH_M]
            is_below[rows_in_box(points[free], *box)] = True
            hanging.append(stem)
    if not is_below.any():
        return free[is_below]
    piece = link_components(points[free], TOUCH_M)
    is_whole = np.bincount(piece, is_below) >= MOST * np.bincount(piece)
    rows, piece = free[is_whole[piece]], piece[is_whole[piece]]
    if not len(rows):
        return rows
    as_wood = labels.copy()
    as_wood[rows] = Label.BRANCH
    grown = grow(cloud.with_fields(label=as_wood))
    inside = np.zeros(len(rows), bool)
    for stem in hanging:
        owner = np.bincount(1 + grown.owner[orchard.owner == stem]).argmax() - 1
        if owner >= 0 and (tree := grown.limbs[owner]):
            inside[claimed_by(_Tubes(tree), points[rows])[0]] = True
    is_stem = np.bincount(piece, inside) >= MOST * np.bincount(piece)
    rows = rows[is_stem[piece]]
    logger.info(f"{len(rows):,} points of things are stems, below the wood that they bear")
    return rows


def follow_down(points: np.ndarray, limbs: Limbs, ground: np.ndarray, stem_gap_m: float) -> None:
    """Let a stem begin on the ground: cut what lies under it, or follow it down from the air."""
    tube, gap = limbs.limbs[0].tube, _over_ground(limbs, ground)
    foot, radius = tube.nodes[0], tube.radius[0]
    heading = tube.nodes[np.searchsorted(tube.way[:-1], HEADING_IN_RADII * radius)] - foot
    heading /= np.linalg.norm(heading)
    if not gap or heading[2] <= 0:
        return
    if gap < 0:
        over_ground = np.interp(foot[2] - gap, np.maximum.accumulate(tube.nodes[:, 2]), tube.way)
        limbs.limbs[0].tube = stretch(tube, min(over_ground, tube.length / 2), tube.length)
        return
    reach, to_ground = claim_radius(tube.radius[:1], limbs.spacing)[0], gap / heading[2]
    down = in_cylinder(points, foot, -heading, float(reach))[1]
    steps = np.concatenate([[0.0], down[(down > 0) & (down <= to_ground)], [to_ground]])
    end = next(iter(steps[:-1][np.diff(steps) > stem_gap_m]), to_ground)
    if end > 0:
        tube.nodes = np.vstack([foot - end * heading, tube.nodes])
        tube.radius = np.append(radius, tube.radius)
    if end < to_ground:
        left = gap - end * heading[2]
        logger.warning("the stem at (%.2f, %.2f) ends %.2f m over the ground", *foot[:2], left)
    else:
        logger.info("stem at (%.2f, %.2f) followed %.3f m to the ground", *foot[:2], gap)


def label_rings(points: np.ndarray, labels: np.ndarray, colors: np.ndarray, tubes: _Tubes) -> None:
    """Label the white rings on the trunk, in place; the network's are wider by its voxels."""
    rows = np.flatnonzero((labels == Label.TRUNK) | (labels == Label.CALIBRATION_UNIT))
    off, nearest = cKDTree(tubes.stem.nodes).query(points[rows])
    near = rows[off <= tubes.reach[tubes.trunk][nearest]]
    is_ring = ring_points(points[near], colors[near], tubes.stem)
    if is_ring.any():
        off_ring = cKDTree(points[near[is_ring]]).query(points[near])[0] > STEP_M
        labels[near[is_ring]] = Label.CALIBRATION_UNIT
        labels[near[off_ring]] = Label.TRUNK
