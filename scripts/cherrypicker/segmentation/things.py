"""Thing or wood first, which thing second, and a marker that was solved is known.

Signs, markers, calibration units and roofs come in more shapes than a network has seen, and it
mixes them up far more often than it takes one for wood. So the points say first, each for itself,
whether they are ground, wood, a support post or a thing of any class; what hangs together of the
things is one thing, whose points then choose together among the classes of things alone.
`estimate_scale` has solved where the markers stand: what lies in a marker's plane is its board,
what hangs below it its stand, and nothing else is one.
"""

import logging

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import CHANNELS, WOOD, Label, wood_mask
from cherrypicker.geometry.neighbors import Neighbors, link_components
from cherrypicker.geometry.sampling import voxel_sample
from cherrypicker.segmentation.known_markers import BOARD, KnownMarkers

logger = logging.getLogger(__name__)

THINGS = (Label.SIGN, Label.MARKER, Label.CALIBRATION_UNIT, Label.ROOF)
# What a point is first; of a group the likeliest class comes second
GROUPS = ((Label.GROUND,), WOOD, THINGS, (Label.SUPPORT_POST,))
LINK = 2.5  # voxels: parts of a thing lie no farther apart (a guess: neighbours with one missing)
TOUCH_M = 0.05  # the same with the shipped weights' voxels
THICK = 2.0  # standard deviations of a board's points across it (of a Gaussian, 95 % of them)
# Least probability of any thing in what may be a rim. Of 477 voxels of rims in three scenes nine
# tenths have it, of 51 of wood beside boards in their plane a fifth, of all wood 1 to 14 % a scene
# (2026-11-27)
RIM = 0.1
STANDS_M = 0.5  # a thing that stands comes this near to the ground (a guess)
# Roofs are flat: points with this many nearest have a least variance of at most this share of all.
# So are 0.79 to 1 of the points of roofs, their posts and wires, 0.01 of a laser scan's crown that
# passes for one (docs/lab/segmentation.md)
N_NEAR, FLAT = 30, 0.05

#: Which channels are of each group.
IN_GROUP = np.array([np.isin(CHANNELS, group) for group in GROUPS])


def group_of(probabilities: np.ndarray) -> np.ndarray:
    """Number of each point's group (n,) int: that whose classes together are the likeliest."""
    return np.argmax([probabilities[:, each].sum(axis=1) for each in IN_GROUP], axis=0)


def keep_roofs(points: np.ndarray, probabilities: np.ndarray, voxel: float) -> np.ndarray:
    """Take the class roof from what is none, such as the dense crown of a laser scan.

    What is built is of sheets and rods, and a crown spreads to all sides: most points of a piece
    decide. Points (n, 3) and probabilities (n, n_channels), float32, are of a voxel sample whose
    neighbours are a `voxel` apart; the result is a copy.
    """
    roof = CHANNELS.index(Label.ROOF)
    rows = np.flatnonzero(probabilities.argmax(axis=1) == roof)
    if not len(rows):
        return probabilities
    cells, cell_of, _ = voxel_sample(points[rows], 2 * voxel)  # posts are wider than a few voxels
    near = cells[Neighbors(cells, N_NEAR - 1).index]
    near = near - near.mean(axis=1, keepdims=True)
    variance = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", near, near))
    is_flat = variance[:, 0] <= FLAT * variance.sum(axis=1)
    piece = link_components(cells, 2 * LINK * voxel)
    is_crown = np.bincount(piece, np.where(is_flat, 1.0, -1.0)) < 0
    lost = rows[is_crown[piece][cell_of]]
    result = probabilities.copy()
    result[lost, roof] = 0.0
    result[lost, CHANNELS.index(Label.BRANCH)] += 1e-6  # what is certain to be a roof is wood then
    result[lost] /= result[lost].sum(axis=1, keepdims=True)
    logger.info(f"{len(lost):,} of {len(rows):,} points of roof are of none")
    return result


def vote_per_object(
    points: np.ndarray, probabilities: np.ndarray, voxel: float, markers: KnownMarkers
) -> np.ndarray:
    """Let the points of each thing decide together which thing it is.

    A roof or net spans a scene and would outvote what touches it: its points vote by themselves.
    Of a voxel sample as in `keep_roofs`, in the markers' frame. The board of a solved marker votes
    for marker, and no thing is one that holds no board and lies where none may be. In the copy a
    thing's points are certain of its class, and so is wood that is a board's rim.
    """
    group = group_of(probabilities)
    is_thing, is_wood = group == GROUPS.index(THINGS), group == GROUPS.index(WOOD)
    columns = np.flatnonzero(IN_GROUP[GROUPS.index(THINGS)])
    marker = CHANNELS.index(Label.MARKER)
    board = markers.hold(points, voxel) | (markers.hold(points, voxel, BOARD) & is_thing)
    rows = np.flatnonzero(is_thing | board)
    votes = probabilities[np.ix_(rows, columns)].astype(np.float64)
    is_roof = columns[votes.argmax(axis=1)] == CHANNELS.index(Label.ROOF)
    thing = np.empty(len(rows), np.int64)
    thing[is_roof] = link_components(points[rows[is_roof]], LINK * voxel)
    thing[~is_roof] = link_components(points[rows[~is_roof]], LINK * voxel)
    thing[is_roof] += 1 + thing[~is_roof].max(initial=-1)
    may_be = np.bincount(thing, board[rows] | markers.is_open(points[rows])) > 0
    votes[~may_be[thing], columns == marker] = 0.0
    votes[board[rows]] = columns == marker
    total = np.stack([np.bincount(thing, weights=column) for column in votes.T], axis=1)
    kind = columns[total.argmax(axis=1)]
    chosen = kind[thing]
    changed = np.count_nonzero(chosen != probabilities[rows].argmax(axis=1))
    result, certain = probabilities.copy(), np.eye(len(CHANNELS), dtype=np.float32)
    result[rows] = certain[chosen]
    board_of = np.full(len(points), -1)
    board_of[rows] = np.where(np.isin(chosen, [CHANNELS.index(Label.SIGN), marker]), thing, -1)
    may_be = is_wood & (probabilities[:, columns].sum(axis=1) >= RIM)
    rim = _grow_rims(points, board_of, may_be, LINK * voxel)
    result[rim] = certain[kind[board_of[rim]]]
    result[board] = certain[marker]
    logger.info(
        f"{thing.max(initial=-1) + 1} things; {changed:,} of their {len(rows):,} points changed "
        f"class; {len(rim):,} points of wood are rims of boards, {np.count_nonzero(board):,} are "
        f"of {len(markers.squares)} solved markers"
    )
    return result


def _grow_rims(
    points: np.ndarray, board_of: np.ndarray, may_be: np.ndarray, reach: float
) -> np.ndarray:
    """Number what may be a rim (n,) and lies in the plane of a board as the board; return its rows.

    Stereo finds the edges of a plain board, which pass for branches. They are taken from it on,
    until there are no more. ``board_of`` (n,) numbers the things, -1 elsewhere; one is a board
    where it is more a sheet than a rod or a lump, by the dimensionality features of Demantke et al.
    2011.
    """
    was = board_of >= 0
    while True:
        boards, wood = np.flatnonzero(board_of >= 0), np.flatnonzero(may_be & (board_of < 0))
        away, nearest = cKDTree(points[boards]).query(points[wood], distance_upper_bound=reach)
        wood, beside = wood[np.isfinite(away)], board_of[boards[nearest[np.isfinite(away)]]]
        is_rim = np.zeros(len(wood), bool)
        for number in np.unique(beside):
            own = points[board_of == number]
            middle = own.mean(axis=0)
            _, spread, ways = np.linalg.svd(own - middle, full_matrices=False)
            if len(own) > 2 and spread[1] - spread[2] > max(spread[0] - spread[1], spread[2]):
                thick = THICK * spread[2] / np.sqrt(len(own))
                off = np.abs((points[wood] - middle) @ ways[2])
                is_rim |= (beside == number) & (off <= thick)
        if not is_rim.any():
            return np.flatnonzero((board_of >= 0) & ~was)
        board_of[wood[is_rim]] = beside[is_rim]


def loose_wood(points: np.ndarray, labels: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Labels (n,) in which wood that hangs on no stem is of the thing that it touches, or branch.

    So the post of a sign goes to its board, and a board most of which passes for wood to the rest
    of it. Points (n, 3), owners (n,) as of `cherrypicker.wood.target_wood.SharedWood`.
    """
    result = labels.copy()
    loose = np.flatnonzero(wood_mask(labels) & (owner < 0))
    result[loose] = Label.BRANCH
    things = np.flatnonzero(np.isin(labels, THINGS))
    piece = link_components(points[loose], TOUCH_M)
    nearest = cKDTree(points[things]).query(points[loose], distance_upper_bound=TOUCH_M)[1]
    touched = np.append(labels[things], Label.UNLABELLED)[nearest]  # the last where none is near
    votes = [np.bincount(piece, touched == label) for label in THINGS]
    given = np.any(votes, axis=0)[piece]
    result[loose[given]] = np.array(THINGS, np.uint8)[np.argmax(votes, axis=0)[piece[given]]]
    logger.info(f"{np.count_nonzero(given):,} points of loose wood are of things")
    return result
