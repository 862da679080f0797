"""Several trees in one scan: which stand there, whose wood is whose, and a cloud of each."""

import numpy as np
import pytest
from skeleton_shapes import labelled_cloud, tube

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.limbs.orchard import MOST_POINTS
from cherrypicker.wood.row import NO_TREE, NO_WOOD, find_trees, read_places, rows_of_tree
from cherrypicker.wood.target_wood import share_cloud
from cherrypicker.wood.thinned import GrowthOptions

DENSITY = 20_000
SPACING = 1.0
LIMB = 0.7  # m from stem to tip: neighbours reach 0.4 m into one another
FEET = SPACING * np.arange(3)


def fruit_tree(rng, x):
    """A stem, and limbs along the row at a height of their own, which cross those of neighbours."""
    side = 0.1 * (1 if round(x / SPACING) % 2 else -1)
    pieces = [tube((x, 0, 0), (x, 0, 1.4), 0.04, DENSITY, rng=rng)]
    for way, z in ((1.0, 0.6), (-1.0, 0.8), (1.0, 1.2), (-1.0, 1.0)):
        tip = (x + way * LIMB, side * way, z + 0.3)
        pieces.append(tube((x, 0, z), tip, 0.015, DENSITY, rng=rng, end_radius=0.004))
    labels = [Label.TRUNK] + [Label.BRANCH] * 4
    return np.vstack(pieces), np.repeat(labels, [len(piece) for piece in pieces])


@pytest.fixture(scope="module")
def row():
    """Three trees, a post between two of them, and ground; the tree of each point (-1 none)."""
    rng = np.random.default_rng(0)
    parts = [fruit_tree(rng, x) for x in FEET]
    post = tube((1.5, 0.5, 0), (1.5, 0.5, 0.9), 0.02, DENSITY, rng=rng)
    soil = np.column_stack([rng.uniform((-3, -2), (5, 2), (20_000, 2)), np.zeros(20_000)])
    parts += [(post, np.full(len(post), Label.TRUNK)), (soil, np.full(len(soil), Label.GROUND))]
    truth = np.repeat([1, 2, 3, NO_TREE, NO_WOOD], [len(points) for points, _ in parts])
    points, labels = (np.concatenate(column) for column in zip(*parts))
    return labelled_cloud(points, labels), truth


@pytest.fixture(scope="module")
def shared(row):
    return share_cloud(row[0], GrowthOptions(), MOST_POINTS)


@pytest.fixture(scope="module")
def found(row, shared):
    return find_trees(row[0], shared)


def test_every_tree_is_found_in_the_order_of_the_row_and_a_post_is_none(found):
    feet = np.array([tree.base[:2] for tree in found.trees])
    np.testing.assert_allclose(feet, np.column_stack([FEET, np.zeros(3)]), atol=0.03)
    (post, reason), *others = found.left_out
    np.testing.assert_allclose(post.base[:2], [1.5, 0.5], atol=0.03)
    assert "% of the heaviest tree's wood" in reason and not others


def test_each_has_its_own_wood_where_the_crowns_touch(row, found):
    _, truth = row
    for number in (1, 2, 3):
        own, true = found.owner == number, truth == number
        assert np.sum(own & true) / np.sum(own | true) > 0.9
        assert np.sum(own & ~true) / np.sum(own) < 0.03
    np.testing.assert_array_equal(found.owner == NO_WOOD, truth == NO_WOOD)


def test_a_list_numbers_the_trees_as_it_names_them(row, shared, found):
    cloud, _ = row
    two = find_trees(cloud, shared, [(2.1, 0.05), (0.0, -0.1)])
    np.testing.assert_array_equal(two.owner == 1, found.owner == 3)
    np.testing.assert_array_equal(two.owner == 2, found.owner == 1)
    report = two.report("row", factor=2.0, unit="m")
    assert [one["tree"] for one in report["trees"]] == ["row_1", "row_2"]
    assert report["trees"][0]["crop_target_xy"] == pytest.approx([1.0, 0.0], abs=0.02)
    assert {one["reason"] for one in report["left_out"]} == {
        "no place of crop.target_xy is nearest to it"
    }


@pytest.mark.parametrize(
    "places, told",
    [
        ([(0.0, 0.0), (0.1, 0.0)], "places 1 and 2 mean one stem"),
        ([(0.0, 0.0), (30.0, 0.0)], "lies outside the wood"),
    ],
)
def test_places_that_mean_no_tree_of_their_own_are_refused(row, shared, places, told):
    with pytest.raises(StageError, match=told) as caught:
        find_trees(row[0], shared, places)
    assert caught.value.key == "crop.target_xy"


def test_a_trees_cloud_has_its_wood_alone_and_the_ground_about_it(row, found):
    cloud, truth = row
    own = cloud.select(rows_of_tree(cloud.points, found.owner, 3, found.trees[2].base))
    wood = own["label"] != Label.GROUND
    assert np.count_nonzero(wood) == np.count_nonzero(found.owner == 3)
    aside = np.linalg.norm(own.points[~wood, :2] - [2.0, 0.0], axis=1)
    assert 1.2 < aside.max() < 1.6  # as far as the tree is high
    with pytest.raises(StageError, match="not of one scan"):
        rows_of_tree(cloud.points, found.owner[1:], 3, found.trees[2].base)


def test_places_from_a_command_line(row):
    assert read_places(["all"]) == read_places("all") == "all"
    np.testing.assert_array_equal(read_places(["1", "2", "3", "4"]), [[1, 2], [3, 4]])
    for wrong in (["1"], ["all", "1"], []):
        with pytest.raises(StageError, match="no list of places"):
            read_places(wrong)
