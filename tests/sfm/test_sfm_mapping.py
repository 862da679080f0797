"""Which attempt to map a scan is chosen: a fragment is no better for fitting the verified pairs."""

from types import SimpleNamespace

import pytest

from cherrypicker.sfm.mapping import Attempt, Mapper, MappingOptions


def attempt(name, n_registered, *, pairs, n_known, n_pairs=50):
    """What one way of mapping 66 photos came to."""
    errors = {str(number): 0.5 if number < n_known else 9.0 for number in range(n_registered)}
    model = SimpleNamespace(num_reg_images=lambda: n_registered)
    return Attempt(name, "", model, pairs, n_pairs, [], 66, None, errors)


@pytest.fixture
def mapped(monkeypatch):
    """Run a mapper whose first and second attempt are given; names, the chosen one first."""

    def run(first, second, **options):
        mapper = object.__new__(Mapper)
        mapper.options, mapper.limit_px = MappingOptions(**options), 1.5
        mapper.database, asked = None, []
        monkeypatch.setattr(mapper, "_attempt", lambda *_: first)
        monkeypatch.setattr(mapper, "_leave_out", lambda best: best)
        again = lambda _, known: asked.append(len(known)) or second  # noqa: E731
        monkeypatch.setattr(mapper, "_register_again", again)
        return [each.name for each in mapper.run()], asked

    return run


def test_a_model_that_lacks_cameras_is_completed_from_those_known(mapped):
    first = attempt("first", 66, pairs=1.0, n_known=60)
    assert mapped(first, attempt("again", 66, pairs=1.0, n_known=64)) == (["again", "first"], [60])
    assert mapped(first, attempt("again", 66, pairs=1.0, n_known=60)) == (["first", "again"], [60])
    assert mapped(first, None, wanted_registered_fraction=0.9) == (["first"], [])


def test_a_bent_model_is_mapped_again_and_no_fragment_takes_its_place(mapped):
    bent = attempt("bent", 60, pairs=0.8, n_known=60)
    straight = attempt("again", 58, pairs=0.95, n_known=50)
    fragment = attempt("again", 5, pairs=1.0, n_known=5)
    assert mapped(bent, straight, wanted_registered_fraction=0.1) == (["again", "bent"], [0])
    assert mapped(bent, None, wanted_registered_fraction=0.0) == (["bent"], []), "no second try"
    assert mapped(bent, fragment) == (["bent", "again"], [0])
    unsure = attempt("again", 60, pairs=0.95, n_known=0)
    assert mapped(bent, unsure) == (["again", "bent"], [0]), "no camera is better than wrong ones"


def test_a_model_that_no_pair_judges_keeps_its_cameras(mapped):
    unjudged = attempt("first", 40, pairs=0.0, n_known=30, n_pairs=0)
    assert mapped(unjudged, attempt("again", 40, pairs=1.0, n_known=35))[1] == [30]
