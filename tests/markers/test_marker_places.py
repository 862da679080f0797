"""Tables and scenes that contradict each other: markers missing, printed twice, or moved."""

import pytest
from marker_scene import marker_scan, square
from scan_scene import look_at_poses, ring
from sound_tree import flags_of

from cherrypicker.errors import StageError
from cherrypicker.markers.estimate_scale import estimate_scale
from cherrypicker.traits.reports import Reports

pytestmark = pytest.mark.usefixtures("read_once")
DICTIONARY, SIDE = "DICT_4X4_50", 0.25
HERE, THERE = [0.3, -0.1, 0.05], [-0.4, 0.2, 0.02]
POSES = look_at_poses(ring(8, radius=2.2, heights=(1.2, 1.8)), [0.0, 0.0, 0.1])


def marker(at, marker_id=7, side=SIDE):
    return DICTIONARY, marker_id, square(at, side, turn_deg=20)


def estimate(photos, model, sides_m="7:0.25", **changes):
    options = {"cell": "", "mode": "marker", "dictionary": DICTIONARY, "sides_m": sides_m}
    return estimate_scale(photos, model, **(options | changes), min_images=2)


@pytest.fixture(scope="module")
def render(tmp_path_factory):
    """A scan of markers, in metres, rendered once each."""
    scans = {}

    def scan(*markers):
        key = repr(markers)
        if key not in scans:
            scans[key] = marker_scan(tmp_path_factory.mktemp("scan"), markers, POSES)
        return scans[key]

    return scan


@pytest.fixture(scope="module")
def moved(render):
    """The first three photos show the marker in one place, the others in another."""
    first, model = render(marker(HERE))
    return [*first[:3], *render(marker(THERE))[0][3:]], model


def test_a_marker_of_a_dictionary_that_no_row_names_is_known(render):
    beside = "DICT_6X6_250", 48, square(THERE, 0.2)
    report = estimate(*render(marker(HERE), beside))
    (other,) = report["other_markers"]
    assert (other["dictionary"], other["id"], other["n_images"]) == ("DICT_6X6_250", 48, 8)
    assert sum(other["corners"]) / 4 == pytest.approx(THERE, abs=0.005)
    assert not report["doubts"] and not report["false_reads"]


def test_a_longer_dictionary_of_the_same_codes_reads_no_marker_twice(render):
    report = estimate(*render(marker(HERE)), sides_m="7:0.25", dictionary="dict_4x4_100")
    assert (report["dictionary"], len(report["markers"])) == ("DICT_4X4_100", 1)
    assert not report["other_markers"] and not report["doubts"]


def test_an_id_that_no_photo_shows_is_told_by_name(render):
    report = estimate(*render(marker(HERE)), sides_m="7:0.25,9:0.15")
    (doubt,) = report["doubts"]
    assert "marker 9" in doubt and "no photo shows it" in doubt and "marker_sides_m" in doubt
    assert any("marker 9" in flag for flag in flags_of(Reports(scale=report)))
    assert report["scale"] == pytest.approx(1.0, rel=2e-3)


def test_two_of_one_id_that_agree_both_give_the_scale(render):
    report = estimate(*render(marker(HERE), marker(THERE)))
    assert report["scale"] == pytest.approx(1.0, rel=2e-3)
    (doubt,) = report["doubts"]
    assert "marker 7 stands in 2 places" in doubt and "several of one id" in doubt
    assert "jpg shows two of them" in doubt and "marker_sides_m" in doubt
    assert [one["id"] for one in report["markers"]] == [7, 7]
    assert [one["name"] for one in report["references"]] == [
        "marker 7, place 1",
        "marker 7, place 2",
    ]
    assert [one["n_inliers"] for one in report["markers"]] == [8, 8]
    assert all(one["used"] for one in report["references"])
    assert not report["other_markers"] and not report["false_reads"]


def test_two_of_one_id_and_two_sides_are_an_error_that_names_both(render):
    with pytest.raises(StageError, match=r"marker 7, place \d .*contradict") as caught:
        estimate(*render(marker(HERE), marker(THERE, side=0.18)))
    assert "marker_sides_m" in caught.value.key


def test_of_two_sides_the_one_that_another_marker_bears_out_is_used(render):
    photos, model = render(
        marker(HERE), marker(THERE, side=0.18), marker([0.1, 0.5, 0], marker_id=8, side=0.2)
    )
    report = estimate(photos, model, sides_m="7:0.25,8:0.20")
    assert report["scale"] == pytest.approx(1.0, rel=2e-3)
    used = {one["name"]: one["used"] for one in report["references"]}
    assert used["marker 8"] and sum(used.values()) == 2
    assert any("is left out" in doubt for doubt in report["doubts"])


def test_a_marker_that_moved_is_told_and_both_its_places_are_known(moved):
    report = estimate(*moved)
    assert report["scale"] == pytest.approx(1.0, rel=3e-3)
    (doubt,) = report["doubts"]
    assert "marker 7 stands in 2 places, in 5 and 3 photos" in doubt
    assert "no photo shows two of them: it was moved" in doubt
    middles = [sum(one["corners"]) / 4 for one in report["markers"]]
    assert middles[0] == pytest.approx(THERE, abs=0.01)
    assert middles[1] == pytest.approx(HERE, abs=0.01)
    assert any("scale_doubtful: marker 7" in flag for flag in flags_of(Reports(scale=report)))


def test_a_distance_to_a_marker_in_two_places_gives_no_scale(moved, render):
    photos, model = render(marker(HERE), marker(THERE), marker([0.1, 0.5, 0], marker_id=8))
    bar = [{"kind": "distance", "markers": [7, 8], "length_m": 1.0}]
    report = estimate(photos, model, sides_m="7:0.25,8:0.25", references=bar)
    (line,) = [line for line in report["doubts"] if line.startswith("distance")]
    assert "marker 7 stands in 2 places" in line


def test_without_any_marker_the_error_names_what_was_read(render):
    with pytest.raises(StageError, match=r"marker 9 in 0 of 8\).*DICT_4X4_50 7 \(8\)"):
        estimate(*render(marker(HERE)), sides_m="9:0.25")
