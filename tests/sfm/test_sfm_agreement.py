"""A bent model is found out by the verified pairs, and a fragment is no better for fitting them."""

from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest

from cherrypicker.sfm.agreement import Agreement, measure_agreement, read_verified_pairs
from cherrypicker.sfm.mapping import Attempt, Mapper, MappingOptions


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """A synthetic model and the database of its matches."""
    path = tmp_path_factory.mktemp("ring") / "database.db"
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 10
    options.num_points3D = 150
    with pycolmap.Database.open(path) as database:
        model = pycolmap.synthesize_dataset(options, database)
    return model, path


def test_a_true_model_agrees(ring):
    model, path = ring
    agreement = measure_agreement(model, read_verified_pairs(path), 2.0)
    assert agreement.n_pairs > 5
    assert agreement.pairs == 1.0
    assert agreement.matches > 0.99
    assert agreement.median_error_px < 0.1


def test_a_bent_model_does_not(ring):
    model, path = ring
    pairs = read_verified_pairs(path)
    bent = pycolmap.Reconstruction(model)
    for i, image_id in enumerate(sorted(bent.reg_image_ids())):
        image = bent.images[image_id]
        turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, 0.02 * i, 0.0])), np.zeros(3))
        image.frame.rig_from_world = turn * image.frame.rig_from_world
    agreement = measure_agreement(bent, pairs, 2.0)
    assert agreement.pairs < 0.7
    assert agreement.matches < 0.9


def test_pairs_of_unregistered_photos_do_not_count(ring):
    model, path = ring
    empty = measure_agreement(pycolmap.Reconstruction(), read_verified_pairs(path), 2.0)
    assert empty.n_pairs == 0
    assert empty.pairs == 0.0
    assert empty.median_error_px is None, "the report is JSON, which holds no infinity"
    few = read_verified_pairs(path, min_inliers=10**6)
    assert not few


def attempt(name, n_registered, *, pairs, n_known, n_pairs=50):
    """What one way of mapping 66 photos came to."""
    errors = {str(number): 0.5 if number < n_known else 9.0 for number in range(n_registered)}
    model = SimpleNamespace(num_reg_images=lambda: n_registered)
    agreement = Agreement(n_pairs, pairs, pairs, 0.5)
    return Attempt(name, "", "incremental", model, agreement, [], 66, None, errors)


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
    assert mapped(first, None, max_attempts=1) == (["first"], [])


def test_a_bent_model_is_mapped_again_and_no_fragment_takes_its_place(mapped):
    bent = attempt("bent", 60, pairs=0.8, n_known=60)
    straight = attempt("again", 58, pairs=0.95, n_known=50)
    fragment = attempt("again", 5, pairs=1.0, n_known=5)
    assert mapped(bent, straight, wanted_registered_fraction=0.0) == (["again", "bent"], [0])
    assert mapped(bent, fragment) == (["bent", "again"], [0])


def test_a_model_that_no_pair_judges_keeps_its_cameras(mapped):
    unjudged = attempt("first", 40, pairs=0.0, n_known=30, n_pairs=0)
    assert mapped(unjudged, attempt("again", 40, pairs=1.0, n_known=35))[1] == [30]
