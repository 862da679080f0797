"""Hand corrections: anchored in space, one rooted tree or an error, nothing dropped in silence."""

import numpy as np
import pytest
from sound_tree import flags_of

from cherrypicker.errors import StageError
from cherrypicker.skeleton.edits import Edit, apply_edits, read_edits
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.reports import Reports


@pytest.fixture
def forked():
    """A stem of 1 m with branches of 0.3 m at 0.4 (towards +x) and 0.6 m (towards -x)."""
    z = np.arange(101) / 100
    stem = np.column_stack([np.zeros(101), np.zeros(101), z])
    x = np.arange(1, 31) / 100
    right = np.column_stack([x, np.zeros(30), np.full(30, 0.4)])
    left = np.column_stack([-x, np.zeros(30), np.full(30, 0.6)])
    parent = np.concatenate(
        [np.arange(-1, 100), [40], np.arange(101, 130), [60], np.arange(131, 160)]
    )
    points = np.vstack([stem, right, left])
    return Skeleton(points, parent, np.full(161, 0.01), np.ones(161, dtype=int))


def edit(kind, tolerance=0.03, **places):
    names = {"start": "from", "to": "to", "at": "at"}
    places = {names[key]: np.array(value, dtype=float) for key, value in places.items()}
    return Edit(kind, places, tolerance)


def has_node(skeleton, place):
    return np.linalg.norm(skeleton.points - place, axis=1).min() < 1e-9


def test_delete_takes_all_that_lies_beyond(forked):
    edited, report = apply_edits(forked, [edit("delete", at=(0.011, 0.01, 0.4))])
    assert len(edited) == 161 - 30
    assert report["n_applied"] == 1 and not report["lost"]
    assert report["length_dropped"] == pytest.approx(0.3)


def test_cut_and_connect_hang_a_branch_elsewhere(forked):
    edits = [
        edit("cut", at=(0.01, 0, 0.4)),
        edit("connect", start=(0.3, 0, 0.4), to=(0, 0, 1)),  # its tip: the piece turns round
    ]
    edited, report = apply_edits(forked, edits)
    assert len(edited) == 161
    assert report["length_dropped"] == pytest.approx(0.0)
    tip = np.argmin(np.linalg.norm(edited.points - (0.01, 0, 0.4), axis=1))
    assert edited.n_children[tip] == 0
    expected = 1 + np.hypot(0.3, 0.6) + 0.29
    assert edited.distance_to_root()[tip] == pytest.approx(expected)
    assert edited.fields["gap"].sum() == 1  # the new edge bridges missing data


def test_connect_moves_a_branch_with_all_it_bears(forked):
    edited, _ = apply_edits(forked, [edit("connect", start=(0.01, 0, 0.4), to=(0, 0, 0.45))])
    foot = np.argmin(np.linalg.norm(edited.points - (0.01, 0, 0.4), axis=1))
    np.testing.assert_allclose(edited.points[edited.parent[foot]], (0, 0, 0.45))
    assert len(edited) == 161


def test_move_keeps_the_tree(forked):
    edited, _ = apply_edits(forked, [edit("move", start=(0.3, 0, 0.4), to=(0.3, 0, 0.42))])
    assert has_node(edited, (0.3, 0, 0.42)) and not has_node(edited, (0.3, 0, 0.4))
    moved = np.argmin(np.linalg.norm(edited.points - (0.3, 0, 0.42), axis=1))
    np.testing.assert_allclose(edited.points[edited.parent[moved]], (0.29, 0, 0.4))
    assert len(edited) == 161 and edited.n_children[moved] == 0


def test_places_hold_when_node_ids_change(forked):
    edits = [edit("delete", at=(-0.01, 0, 0.6))]
    order = np.concatenate([np.arange(101), np.arange(131, 161), np.arange(101, 131)])
    new_id = np.argsort(order)
    parent = np.where(forked.parent >= 0, new_id[forked.parent], -1)[order]
    other = Skeleton(forked.points[order], parent, forked.radius, forked.label)
    first, second = apply_edits(forked, edits)[0], apply_edits(other, edits)[0]
    np.testing.assert_array_equal(first.points, second.points)


def test_lost_edits_are_reported_and_change_nothing(forked):
    edited, report = apply_edits(forked, [edit("cut", at=(1, 1, 1)), edit("delete", at=(0, 0, 1))])
    assert len(edited) == 160
    assert report["n_applied"] == 1 and report["n_edits"] == 2
    assert report["lost"] == ["edit 1 (cut at (1, 1, 1)): no node within 0.03 of at"]
    flags = flags_of(Reports(edits=report))
    assert len(flags) == 1 and flags[0].startswith("edits_lost: 1 of 2 hand corrections")


def test_no_cycle_and_no_tree_without_its_root(forked):
    with pytest.raises(StageError, match="close a cycle.*; file: tree.yaml; change: graph.edits"):
        cycle = edit("connect", start=(0.01, 0, 0.4), to=(0.2, 0, 0.4))
        apply_edits(forked, [cycle], "tree.yaml")
    with pytest.raises(StageError, match="remove the root"):
        apply_edits(forked, [edit("delete", at=(0, 0, 0))])
    with pytest.raises(StageError, match="leave nothing"):
        apply_edits(forked, [edit("cut", at=(0, 0, 0.01))])


def test_files_are_read_and_bad_ones_refused(tmp_path):
    path = tmp_path / "tree.yaml"
    path.write_text(
        "edits:\n"
        "  - connect: {from: [0.1, 0, 1], to: [0, 0, 1]}\n"
        "    tolerance_m: 0.1\n"
        "    note: hangs on the scaffold below\n"
        "  - delete: {at: [1, 2, 3]}\n"
    )
    first, second = read_edits(path)
    assert (first.kind, first.tolerance, second.kind, second.tolerance) == (
        "connect",
        0.1,
        "delete",
        0.05,
    )
    np.testing.assert_array_equal(second.places["at"], (1, 2, 3))
    for text, message in [
        ("edits: 3", "no list"),
        ("edits: [{cut: {at: [1, 2]}}]", "three finite numbers"),
        ("edits: [{cut: {at: [1, 2, x]}}]", "three finite numbers"),
        ("edits: [{cut: {at: [1, 2, true]}}]", "three finite numbers"),
        ("edits: [{cut: {at: [1, 2, 3]}, tolerance_m: true}]", "positive number"),
        ("edits: [{cut: {at: [2026-02-30, 2, 3]}}]", "cannot be read"),
        ("edits: " + 50 * "[" + 50 * "]", "lie deeper than"),
        ("a: &a [1]\nb: &b [*a]\nedits: [*b]", "inside another"),
        ("edits: [{cut: {from: [1, 2, 3]}}]", "cut needs at"),
        ("edits: [{prune: {at: [1, 2, 3]}}]", "one of connect"),
        ("edits: [{cut: {at: [1, 2, 3]}, tolerance_m: 0}]", "positive"),
        ("edits: [", "cannot be read"),
    ]:
        path.write_text(text)
        with pytest.raises(StageError, match=message):
            read_edits(path)
