"""Tests of numbers that are changed one at a time."""

import ablate_numbers
import pytest

MODULE = "# px (guess)\nA, B = 3, np.float32(0.5)\n# measured\nC = 1.0\n"


@pytest.fixture
def changes(tmp_path, monkeypatch):
    (tmp_path / "scripts" / "cherrypicker" / "mvs").mkdir(parents=True)
    (tmp_path / "scripts" / "cherrypicker" / "mvs" / "views.py").write_text(MODULE)
    monkeypatch.setattr(ablate_numbers, "PROJECT", tmp_path)
    monkeypatch.setattr(ablate_numbers, "PACKAGE", tmp_path / "scripts" / "cherrypicker")
    return lambda *asked: [(each[1], each[4]) for each in ablate_numbers.all_changes(*asked)]


def test_guesses_are_multiplied_and_whole_numbers_stay_whole(changes):
    halved, doubled = "A, B = (1, np.float32(0.25))", "A, B = (6, np.float32(1.0))"
    assert changes("mvs", {}, (0.5, 2.0)) == [("A", halved), ("A", doubled)]
    assert changes("sfm", {}, (0.5, 2.0)) == []


def test_a_number_that_is_named_may_become_anything(changes):
    assert changes("mvs", {"C": "np.inf"}, (0.5,)) == [("C", "C = np.inf")]
    assert changes("mvs", {"C": ""}, (0.5,)) == [("C", "C = 0.5")]
