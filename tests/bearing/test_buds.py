"""Buds drawn onto twigs before the sky: which are found, and what is taken for none."""

import csv

import numpy as np
import pytest
from checked_scene import STEM, skeleton_of
from finished_tree import write_finished_tree
from sky_scene import BARK, Rod, draw, ring
from stage_run import run_stage

from cherrypicker.bearing.ages import age_tree
from cherrypicker.bearing.buds import (
    BUD_COLUMNS,
    bulges,
    find_buds,
    noise_of,
    peaks,
    reach_of_wood,
)
from cherrypicker.bearing.measure import KINDS, kind_chances, measure_bearing
from cherrypicker.bearing.rates import read_rates
from cherrypicker.files import read_json, write_text
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.geometry.directions import tangent_basis, unit
from cherrypicker.mvs.raster import HIDDEN, make_raster
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.sky.mask_files import write_mask
from cherrypicker.traits.branches import branches_csv
from cherrypicker.traits.table import LIMB_COLUMNS

TWIGS = tuple(
    Rod((0, 0, z), (0.32 * np.cos(turn), 0.32 * np.sin(turn), z + 0.05), 0.003, BARK)
    for z, turn in ((1.06, 0.3), (1.14, 2.2), (1.22, 4.1))
)
AT_M = np.arange(0.06, 0.3, 0.035)  # of a twig's buds, from its start


def buds_on(twig):
    """Buds of 8 mm that stand out at a slant, each two fifths of a turn on from the one before."""
    start, along = np.array(twig.start), unit(np.subtract(twig.end, twig.start))
    first, second = tangent_basis(along)
    for k, at in enumerate(AT_M):
        side = np.cos(2.5 * k) * first + np.sin(2.5 * k) * second
        seat = start + at * along + 0.8 * twig.radius * side
        yield Rod(tuple(seat), tuple(seat + 0.008 * unit(along + side)), 0.0016, BARK)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Photos of rods with pixels of 1.7 mm, looked at with half of them before they are asked.

    One photo has more rods; or all is hidden.
    """

    def of(rods, more=(), *, is_hidden=False):
        poses = ring(16, focal=1500.0, size=(600, 400))
        folder, drawn = tmp_path_factory.mktemp("shown"), {}
        for i, name in enumerate(poses.names.tolist()):
            drawn[name], sky = draw(poses, i, (*rods, *(more if i == 3 else ())), "overcast")
            raster = make_raster(drawn[name], sky, np.zeros(sky.shape, dtype=bool))[::2, ::2]
            write_mask(folder / f"{i}.png", np.full_like(raster, HIDDEN) if is_hidden else raster)
        looked_at = poses.resized(poses.width // 2, poses.height // 2)
        return ScanPhotos(looked_at, folder, read_photo=lambda name, _: drawn[name])

    return of


@pytest.fixture(scope="module")
def skeleton():
    return skeleton_of((STEM, *TWIGS))


@pytest.fixture(scope="module")
def found(photos, skeleton):
    rods = [STEM, *TWIGS, *(bud for twig in TWIGS for bud in buds_on(twig))]
    return find_buds(skeleton, axes(skeleton), photos(rods))


def test_buds_are_found_where_they_are(found):
    drawn = [bud for twig in TWIGS for bud in buds_on(twig)]
    true = np.array([np.add(bud.start, bud.end) / 2 for bud in drawn])
    there = np.array([[row[name] for name in "xyz"] for row in found.found])
    apart = np.linalg.norm(there[:, None] - true[None], axis=2)
    assert (apart.min(axis=1) < 0.01).all()
    # Level photos of level twigs do not show what stands out aside
    assert len(set(apart.argmin(axis=1))) == len(there) >= 0.7 * len(true)
    assert 0.001 < np.median([row["stands_out_m"] for row in found.found]) < 0.006
    assert all(row["n_photos"] >= 4 for row in found.found)


def test_they_are_counted_on_the_edges_that_bear_them(found, skeleton):
    assert found.n_on.sum() == len(found.found)
    thick = skeleton.radius > 0.008
    assert found.told_m[thick].sum() == 0
    assert (found.told_m <= skeleton.edge_length + 1e-9).all()
    # All of the twigs but their ends and where they leave the stem
    assert 0.7 < found.told_m.sum() / (3 * 0.324) < 0.95


@pytest.mark.parametrize("of_one", [False, True])
def test_nothing_is_told_of_bare_twigs(photos, skeleton, of_one):
    """Nor of what bulges in one photo."""
    more = [bud for twig in TWIGS for bud in buds_on(twig)] if of_one else ()
    none = find_buds(skeleton, axes(skeleton), photos((STEM, *TWIGS), more))
    assert none.found == [] and none.told_m.sum() == 0


def test_nothing_is_told_of_what_the_photos_do_not_show(photos, skeleton):
    none = find_buds(skeleton, axes(skeleton), photos((STEM, *TWIGS), is_hidden=True))
    assert none.found == [] and none.told_m.sum() == 0


def test_what_bulges_to_one_side_is_told_by_that_side():
    """Six photos from one direction show a bulge of 5 mm by 2 mm, which is smoothed, at 50 mm."""
    side = np.full((6, 2, 101), 0.003, dtype=np.float32)
    side[:, 1, 48:53] += 0.002
    height, dent = bulges(side, np.zeros((6, 101), dtype=np.float32))
    assert height.argmax() == 50 and 0.0012 < height[50] < 0.002
    assert np.nanmax(dent) < 0.0001


def test_dents_tell_from_which_height_on_bulges_are_counted():
    """Above 10.3 are 30 bulges and five dents: noise makes at most a fifth of them."""
    bulges = np.arange(1.0, 41.0)
    assert noise_of(bulges, np.array([10.1, 10.2, 10.3, 10.4, 10.5, 10.6, 10.7, 10.8])) == 10.3
    assert noise_of(bulges, np.array([])) == 0.0
    assert noise_of(bulges, bulges) == np.inf
    assert noise_of(bulges[:4], np.array([])) == np.inf  # too few to tell


def test_bulges_are_told_apart_at_a_buds_length():
    height = np.array([0, 2, 0, 3, 0, *np.zeros(9), 1, np.nan])
    tops, stands_out = peaks(height, np.zeros(len(height), dtype=int))
    assert tops.tolist() == [3, 14] and stands_out.tolist() == [3, 1]
    assert peaks(height, np.repeat([0, 1], [2, len(height) - 2]))[0].tolist() == [1, 3, 14]


def test_shoots_have_so_many_buds_a_metre(found, skeleton):
    tree = MeasuredTree("t", skeleton, axes(skeleton))
    totals, rows = measure_bearing(tree, [], buds=found)
    assert sum(row["buds"] for row in rows) == len(found.found)
    assert sum(row["buds_told_m"] for row in rows) == pytest.approx(found.told_m.sum(), abs=1e-3)
    ages = age_tree(skeleton, tree.axis_list, read_rates())
    shoot = kind_chances(ages.chance)[:, KINDS.index("shoot")]
    assert totals["shoot_buds"] == pytest.approx(found.n_on @ shoot, abs=1e-3)
    share = totals["shoot_buds"] / totals["shoot_buds_told_m"]
    assert totals["shoot_buds_per_m"] == pytest.approx(share, rel=1e-3)
    assert 14 < share < 1 / 0.035


def test_a_tree_without_photos_has_a_table_without_buds(tmp_path):
    folder = tmp_path / "tree"
    write_finished_tree(folder)
    write_text(folder / "limbs.csv", branches_csv([], LIMB_COLUMNS))
    files = {"skeleton": "skeleton.graphml", "limbs": "limbs.csv", "traits": "traits.json"}
    files |= {"pieces": "bearing.csv", "buds": "buds.csv", "bearing": "bearing.json"}
    run_stage("measure_bearing", **{name: folder / file for name, file in files.items()})
    with open(folder / "buds.csv", newline="") as stream:
        assert list(csv.reader(stream)) == [list(BUD_COLUMNS)]
    with open(folder / "bearing.csv", newline="") as stream:
        assert {row["buds"] for row in csv.DictReader(stream)} == {""}
    assert "shoot_buds" not in read_json(folder / "bearing.json")


def test_a_tree_of_thick_wood_has_no_places_to_ask(photos):
    thick = skeleton_of((STEM,))
    none = find_buds(thick, axes(thick), photos((STEM,)))
    assert none.found == [] and none.told_m.sum() == 0 and none.noise_m == np.inf


def test_a_side_with_more_wood_beyond_a_gap_is_not_told():
    """Wood of five samples, and a twig of two behind clear sky on one side."""
    line = np.array(
        [[0.0, 0, 0, 0.9, 1, 1, 1, 0.9, 0, 0, 0], [0.0, 0, 0, 0.9, 1, 1, 1, 0.9, 0, 1, 1]]
    )
    before, after = reach_of_wood(line)
    assert before.tolist() == [1.25, 1.25]
    assert after[0] == 1.25 and np.isnan(after[1])


def test_where_noise_hides_buds_no_density_is_told(found, skeleton):
    tree = MeasuredTree("t", skeleton, axes(skeleton))
    totals, _ = measure_bearing(tree, [], buds=found._replace(noise_m=0.001))
    assert totals["shoot_buds"] > 0 and totals["shoot_buds_per_m"] is None
    assert totals["bud_noise_m"] == 0.001


def test_the_order_of_the_nodes_is_of_no_matter(found, photos, skeleton):
    """Breadth first instead of axis by axis."""
    depth = np.zeros(len(skeleton), dtype=int)
    for node, parent in enumerate(skeleton.parent[1:], 1):
        depth[node] = depth[parent] + 1
    order = np.argsort(depth, kind="stable")
    row = np.empty(len(order), dtype=int)
    row[order] = np.arange(len(order))
    parent = np.where(skeleton.parent >= 0, row[skeleton.parent], -1)[order]
    points, radius, label = skeleton.points, skeleton.radius, skeleton.label
    other = Skeleton(points[order], parent, radius[order], label[order])
    rods = [STEM, *TWIGS, *(bud for twig in TWIGS for bud in buds_on(twig))]
    again = find_buds(other, axes(other), photos(rods))
    assert again.noise_m == pytest.approx(found.noise_m, abs=1e-5)
    assert len(again.found) == len(found.found)
