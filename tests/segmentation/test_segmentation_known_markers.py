"""Markers that the scale solved, as the labels take them."""

import numpy as np

import segment_cloud as stage
from cherrypicker.files import write_json
from cherrypicker.segmentation.known_markers import BOARD, KnownMarkers, known_markers
from cherrypicker.wood.thinned import GrowthOptions

CORNERS = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
NOWHERE = np.zeros((0, 4))
ALIGN = {"transform": [[1.0, 0, 0, 2], [0, 1, 0, 4], [0, 0, 1, 6], [0, 0, 0, 1]]}


def _scale(**changes):
    """scale.json of a scan with a solved marker, half a metre a unit."""
    return {
        "mode": "marker",
        "scale": 0.5,
        "markers": [{"id": 7, "corners": CORNERS.tolist(), "is_square": True}, {"id": 8}],
        "other_markers": [],
        "unsolved_markers": [],
        "false_reads": [],
    } | changes


def test_squares_are_moved_to_the_clouds_frame():
    known = known_markers(_scale(), ALIGN)
    (square,) = known.squares
    assert np.allclose(square, CORNERS / 2 + [1, 2, 3])
    assert known.open_places.shape == (0, 4)


def test_a_false_read_disables_nothing_and_another_marker_is_known_too():
    false = [{"id": 17, "n_images": 4, "photos": ["a.jpg", "b.jpg", "c.jpg", "d.jpg"]}]
    assert len(known_markers(_scale(false_reads=false), ALIGN).squares) == 1
    other = {"id": 9, "corners": (CORNERS + [2, 0, 0]).tolist(), "n_images": 5}
    squares = known_markers(_scale(other_markers=[other]), ALIGN).squares
    assert np.allclose(squares.mean(axis=1), [[1, 2, 3], [2, 2, 3]])


def test_what_was_not_solved_leaves_a_place_open_with_room_for_its_board():
    unsolved = [{"id": 9, "center": [2.0, 0, 0], "radius": 0.7, "n_images": 2}]
    known = known_markers(_scale(unsolved_markers=unsolved), ALIGN)
    assert np.allclose(known.open_places, [[2, 2, 3, 0.35 * (1 + 2 * BOARD)]])
    places = np.array([[2.1, 2, 3], [7.0, 2, 3]])
    assert known.is_open(places).tolist() == [True, False]
    assert not KnownMarkers(open_places=NOWHERE).is_open(places).any()
    assert KnownMarkers().is_open(places).all()


def test_corners_that_are_no_square_are_no_marker():
    bent = {"id": 7, "corners": CORNERS.tolist(), "is_square": False}
    assert known_markers(_scale(markers=[bent]), ALIGN).squares.shape == (0, 4, 3)


def test_a_square_holds_its_print():
    known, points = KnownMarkers(CORNERS[None]), np.array([[0.6, 0, 0], [0.8, 0, 0], [0, 0, 0.2]])
    assert known.hold(points, voxel=0.1).tolist() == [True, False, False]
    assert known.hold(points, voxel=0.1, margin=BOARD).tolist() == [True, True, False]


def test_the_stage_hands_on_the_markers_that_the_scale_solved(tmp_path, monkeypatch):
    given = []

    def segment(cloud, weights, **options):
        given.append(options["markers"])
        return cloud, None

    monkeypatch.setattr(stage, "segment_cloud", segment)
    for name in ("read_cloud", "write_cloud", "write_orchard"):
        monkeypatch.setattr(stage, name, lambda *_: None)
    write_json(tmp_path / "scale.json", _scale())
    write_json(tmp_path / "align.json", ALIGN)
    known = str(tmp_path / "scale.json"), str(tmp_path / "align.json")
    stage.main("metric.ply", "s.ply", "l.npz", *known, growth=GrowthOptions())
    stage.main("metric.ply", "s.ply", "l.npz", growth=GrowthOptions())
    assert [len(given[0].squares), given[1]] == [1, None]


def test_what_stands_below_a_solved_marker_may_be_one():
    markers = known_markers(_scale(), ALIGN)
    (middle,) = markers.squares.mean(axis=1)
    below = middle - np.outer([0.5, 1.0], [0, 0, 1])
    assert markers.is_open(below).all()
    assert not markers.is_open(below + [0.6, 0, 0]).any()  # the print is half a metre wide
    assert not markers.is_open(middle + [[0, 0, 0.1]]).any()
