"""Things decide together, and solved markers are known."""

import numpy as np
import pytest

from cherrypicker.classes import CHANNELS, Label
from cherrypicker.segmentation.known_markers import KnownMarkers
from cherrypicker.segmentation.things import (
    GROUPS,
    THINGS,
    group_of,
    keep_roofs,
    loose_wood,
    vote_per_object,
)

VOXEL = 0.02
NOWHERE = np.zeros((0, 4))


def _box(low, high):
    axes = [np.arange(a, b, VOXEL) for a, b in zip(low, high)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _thought(channels, rng, *, share=1.0, other=None):
    """Probabilities with the channel's the largest for a share of the points."""
    likely = np.where(rng.random(len(channels)) < share, channels, other or channels)
    thought = np.full((len(channels), len(CHANNELS)), 0.05, np.float32)
    thought[np.arange(len(channels)), likely] = 0.7
    return thought


def _square(middle, side=0.2):
    """Upright, facing along x."""
    half = side / 2
    return np.add(middle, [[0, -half, -half], [0, half, -half], [0, half, half], [0, -half, half]])


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_a_thing_of_two_opinions_gets_the_one_of_more_points(rng):
    plate = _box([0, 0, 1], [0.02, 0.5, 1.4])
    channels = np.full(len(plate), Label.SIGN.channel)
    thought = _thought(channels, rng, share=0.7, other=Label.MARKER.channel)
    voted = vote_per_object(plate, thought, VOXEL, KnownMarkers())
    assert (voted.argmax(axis=1) == Label.SIGN.channel).all()


def test_a_sign_that_touches_a_net_stays_a_sign(rng):
    net, plate = _box([0.02, -2, 0], [0.04, 2, 2]), _box([0, 0, 0.6], [0.02, 0.5, 1.0])
    channels = np.repeat([Label.ROOF.channel, Label.SIGN.channel], [len(net), len(plate)])
    voted = vote_per_object(
        np.vstack([net, plate]), _thought(channels, rng), VOXEL, KnownMarkers()
    ).argmax(axis=1)
    assert (voted == channels).all()


def test_edges_of_a_plain_board_are_its_own_and_a_branch_before_it_stays(rng):
    board = _box([0, 0, 1], [0.04, 0.5, 1.4])
    is_rim = (np.abs(board[:, 1:] - [0.25, 1.2]) > [0.19, 0.15]).any(axis=1)
    branch = _box([0.06, 0.1, 0.8], [0.1, 0.14, 1.8])
    rod = _box([0, 0.7, 1], [0.02, 0.72, 1.6])  # no sheet, so that it has no plane
    beside = _box([0, 0.74, 1], [0.02, 0.76, 1.6])
    points = np.vstack([board, branch, rod, beside])
    channels = np.repeat(
        [Label.SIGN.channel, Label.BRANCH.channel, Label.SIGN.channel, Label.BRANCH.channel],
        [len(board), len(branch), len(rod), len(beside)],
    )
    channels[: len(board)][is_rim] = Label.BRANCH.channel
    voted = vote_per_object(points, _thought(channels, rng), VOXEL, KnownMarkers()).argmax(axis=1)
    assert (voted[: len(board)] == Label.SIGN.channel).mean() > 0.97
    assert (voted[len(board) :] == channels[len(board) :]).all()


def test_a_tree_trained_in_the_plane_of_a_board_stays_wood(rng):
    board = _box([0, 0, 1], [0.04, 0.3, 1.2])
    wires = [_box([0, 0.3, z], [0.04, 3.0, z + 0.04]) for z in (1.0, 1.1)]
    arms = [_box([0, y, 0.2], [0.04, y + 0.04, 2.2]) for y in (0.6, 1.2, 1.8)]
    wood = np.vstack([*wires, *arms])
    channels = np.repeat([Label.SIGN.channel, Label.BRANCH.channel], [len(board), len(wood)])
    points, thought = np.vstack([board, wood]), _thought(channels, rng)
    thought[len(board) :, [thing.channel for thing in THINGS]] = 0.01
    voted = vote_per_object(points, thought, VOXEL, KnownMarkers()).argmax(axis=1)
    assert (voted == channels).all()


def test_a_solved_marker_is_one_and_what_only_looks_like_one_is_not(rng):
    board = _box([0, -0.14, 0.3], [0.02, 0.14, 0.58])
    legs = _box([0, -0.1, 0.0], [0.02, -0.08, 0.3])
    cube = _box([1.0, 0, 0], [1.2, 0.2, 0.2])
    points = np.vstack([board, legs, cube])
    n_own, n_cube = len(board) + len(legs), len(cube)
    thought = np.vstack(
        [
            _thought(np.full(n_own, Label.CALIBRATION_UNIT.channel), rng),
            _thought(np.full(n_cube, Label.MARKER.channel), rng),
        ]
    )
    thought[n_own:, Label.CALIBRATION_UNIT.channel] = 0.2
    squares = _square([0.01, 0, 0.44])[None]
    channel = vote_per_object(points, thought, VOXEL, KnownMarkers(squares, NOWHERE)).argmax(axis=1)
    assert (channel[:n_own] == Label.MARKER.channel).all()
    assert (channel[n_own:] == Label.CALIBRATION_UNIT.channel).all()
    # without a say of the photos the network is believed
    channel = vote_per_object(points, thought, VOXEL, KnownMarkers()).argmax(axis=1)
    assert (channel[n_own:] == Label.MARKER.channel).all()


def test_a_sign_that_touches_the_board_stays_a_sign(rng):
    board = _box([0, -0.14, 0.0], [0.02, 0.14, 0.28])
    post, plate = _box([0.02, 0, 0.0], [0.04, 0.02, 1.0]), _box([0.02, -0.3, 1], [0.04, 0.3, 1.4])
    sign = np.vstack([post, plate])
    points = np.vstack([board, sign])
    thought = _thought(
        np.repeat([Label.MARKER.channel, Label.SIGN.channel], [len(board), len(sign)]), rng
    )
    squares = _square([0.01, 0, 0.14])[None]
    channel = vote_per_object(points, thought, VOXEL, KnownMarkers(squares, NOWHERE)).argmax(axis=1)
    assert (channel[: len(board)] == Label.MARKER.channel).all()
    above = np.append(np.zeros(len(board), bool), sign[:, 2] > 0.34)
    assert (channel[above] == Label.SIGN.channel).all()


def test_a_thing_that_is_no_marker_is_another_thing_and_never_wood(rng):
    """Wood or thing comes first: what the class that is ruled out thought likely stays a thing."""
    plate = _box([0, 0, 1], [0.02, 0.5, 1.4])
    thought = np.tile(np.float32([0.0, 0.3, 0.1, 0.1, 0.45, 0.05, 0.0, 0.0]), (len(plate), 1))
    assert (group_of(thought) == GROUPS.index(THINGS)).all()
    channel = vote_per_object(plate, thought, VOXEL, KnownMarkers(open_places=NOWHERE)).argmax(
        axis=1
    )
    assert (channel == Label.SIGN.channel).all()


def test_wood_and_ground_keep_their_probabilities(rng):
    points = rng.random((300, 3))
    channels = rng.choice([Label.GROUND.channel, Label.TRUNK.channel, Label.BRANCH.channel], 300)
    thought = _thought(channels, rng)
    assert np.array_equal(
        vote_per_object(points, thought, VOXEL, KnownMarkers(open_places=NOWHERE)), thought
    )


def test_a_print_that_passed_for_grass_is_marker(rng):
    lying = _box([-0.2, -0.2, 0], [0.2, 0.2, 0.02])
    half = 0.1
    square = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    thought = _thought(np.full(len(lying), Label.GROUND.channel), rng)
    channel = vote_per_object(lying, thought, VOXEL, KnownMarkers(square[None], NOWHERE)).argmax(
        axis=1
    )
    on_board = np.abs(lying[:, :2]).max(axis=1) < 0.13
    assert (channel[on_board] == Label.MARKER.channel).all()
    assert (channel[~on_board] == Label.GROUND.channel).all()


def test_a_marker_that_was_not_solved_leaves_the_class_open_around_it(rng):
    board = _box([0, 0, 0.2], [0.2, 0.02, 0.4])
    points = np.vstack([board + [x, 0, 0] for x in (0.0, 1.0, 2.0)])
    thought = _thought(np.full(len(points), Label.MARKER.channel), rng)
    known = KnownMarkers(_square([0.1, 0.01, 0.3])[None], np.array([[1.1, 0.01, 0.3, 0.3]]))
    channel = vote_per_object(points, thought, VOXEL, known)
    of_each = channel.argmax(axis=1).reshape(3, -1)
    assert (of_each[:2] == Label.MARKER.channel).all()
    assert (of_each[2] != Label.MARKER.channel).all()


BOARD = _box([0, -0.2, 0.8], [0.02, 0.2, 1.0])
POST = _box([0, -0.02, 0.0], [0.04, 0.02, 0.8])


def _labelled(*parts):
    """Points, labels and owners of (box, label, owner) triples."""
    points = np.vstack([box for box, *_ in parts])
    labels = np.concatenate([np.full(len(box), label, np.uint8) for box, label, _ in parts])
    return points, labels, np.concatenate([np.full(len(box), own) for box, _, own in parts])


@pytest.mark.parametrize("label", [Label.TRUNK, Label.BRANCH])
def test_wood_that_touches_a_sign_and_hangs_on_no_stem_belongs_to_it(label):
    scene = _labelled((BOARD, Label.SIGN, -1), (POST, label, -1))
    assert (loose_wood(*scene) == Label.SIGN).all()


def test_most_of_a_board_that_passes_for_wood_goes_to_the_rest():
    rim = BOARD[:, 1] < -0.15
    scene = _labelled((BOARD[rim], Label.SIGN, -1), (BOARD[~rim], Label.TRUNK, -1))
    assert (loose_wood(*scene) == Label.SIGN).all()


def test_wood_of_a_stem_that_a_sign_is_tied_to_stays_wood():
    scene = _labelled((BOARD, Label.SIGN, -1), (POST, Label.TRUNK, 0))
    assert np.array_equal(loose_wood(*scene), scene[1])


def test_loose_wood_far_from_things_is_branch_and_a_post_a_post():
    scene = _labelled(
        (BOARD, Label.SIGN, -1), (POST + [1, 0, 0], Label.TRUNK, -1), (POST, Label.SUPPORT_POST, -1)
    )
    found = np.split(loose_wood(*scene), [len(BOARD), len(BOARD) + len(POST)])
    assert [set(each) for each in found] == [{Label.SIGN}, {Label.BRANCH}, {Label.SUPPORT_POST}]


def _called_roof(points):
    return np.tile(np.float32([0.02, 0.02, 0.1, 0.02, 0.02, 0.02, 0.8, 0.0]), (len(points), 1))


def test_a_sheet_and_the_posts_that_carry_it_are_a_roof():
    sheet = _box([0, 0, 2.0], [1.5, 1.0, 2.02])
    sheet[:, 2] += 0.3 * sheet[:, 0]
    post = _box([0, 0, 0], [0.06, 0.06, 2.0])
    points = np.vstack([sheet, post])
    kept = keep_roofs(points, _called_roof(points), VOXEL).argmax(axis=1)
    assert (kept == Label.ROOF.channel).all()


def test_a_net_of_rods_is_a_roof():
    rods = [_box([0, y, 2.0], [1.5, y + 0.02, 2.02]) for y in (0.0, 0.5)]
    points = np.vstack([*rods, _box([0, 0, 2.0], [0.02, 0.5, 2.02])])
    kept = keep_roofs(points, _called_roof(points), VOXEL).argmax(axis=1)
    assert (kept == Label.ROOF.channel).all()


def test_a_dense_crown_is_no_roof(rng):
    points = rng.uniform(0, 1.5, (40_000, 3))
    after = keep_roofs(points, _called_roof(points), VOXEL).argmax(axis=1)
    assert (after == Label.BRANCH.channel).all()
    certain = np.tile(np.eye(len(CHANNELS), dtype=np.float32)[Label.ROOF.channel], (len(points), 1))
    assert (keep_roofs(points, certain, VOXEL).argmax(axis=1) == Label.BRANCH.channel).all()
