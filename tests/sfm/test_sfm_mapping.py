"""Which attempt to map a scan is chosen: by the cameras that are left of it when it is done."""

from types import SimpleNamespace

import pytest

from cherrypicker.sfm import mapping
from cherrypicker.sfm.mapping import Attempt, Mapper, MappingOptions

N_PHOTOS = 66


def attempt(name, n_known, *, pairs, n_pairs=50, n_left_out=0):
    """What one way of mapping 66 photos came to."""
    left_out = {f"unsure {number}": 9.0 for number in range(n_left_out)}
    errors = {str(number): 0.5 for number in range(n_known)}
    model = SimpleNamespace(num_reg_images=lambda: n_known)
    return Attempt(name, "", model, pairs, n_pairs, [], N_PHOTOS, None, errors, left_out)


def mapper_of(**options):
    """A mapper that has no photos."""
    mapper = object.__new__(Mapper)
    mapper.options, mapper.limit_px = MappingOptions(**options), 1.5
    mapper.seed, mapper.threads, mapper.database, mapper.pairs = 0, 1, None, {}
    return mapper


@pytest.fixture
def mapped(monkeypatch):
    """Run a mapper whose first and second attempt are given; names, the chosen one first."""

    def run(first, second, **options):
        mapper, asked = mapper_of(**options), []
        monkeypatch.setattr(mapper, "_attempt", lambda *_: first)
        again = lambda _, known: asked.append(len(known)) or second  # noqa: E731
        monkeypatch.setattr(mapper, "_register_again", again)
        return [each.name for each in mapper.run()], asked

    return run


def test_of_two_models_the_one_with_more_cameras_is_chosen(mapped):
    first = attempt("first", 60, pairs=1.0)
    assert mapped(first, attempt("again", 64, pairs=1.0)) == (["again", "first"], [60])
    for n_known in (59, 60):
        assert mapped(first, attempt("again", n_known, pairs=1.0)) == (["first", "again"], [60])
    whole = attempt("first", N_PHOTOS, pairs=1.0)
    assert mapped(whole, None) == (["first"], []), "all are known"


def test_a_bent_model_is_mapped_again_and_no_fragment_takes_its_place(mapped):
    bent = attempt("bent", 60, pairs=0.8)
    straight = attempt("again", 50, pairs=0.95)
    fragment = attempt("again", 5, pairs=1.0)
    assert mapped(bent, straight) == (["again", "bent"], [0])
    assert mapped(bent, fragment) == (["bent", "again"], [0])
    unsure = attempt("again", 0, pairs=0.0, n_pairs=0, n_left_out=60)
    assert mapped(bent, unsure) == (["again", "bent"], [0]), "no camera is better than wrong ones"


def test_a_model_that_no_pair_judges_keeps_its_cameras(mapped):
    unjudged = attempt("first", 30, pairs=0.0, n_pairs=0)
    assert mapped(unjudged, attempt("again", 35, pairs=1.0))[1] == [30]


@pytest.fixture
def mapped_models(monkeypatch, tmp_path):
    """Run a mapper whose tries give models of so many known and unsure cameras, in turn."""

    def model(n_known, n_unsure, left=None):
        """A model, and what it is without its unsure cameras."""
        errors = {str(i): 0.5 if i < n_known else 9.0 for i in range(n_known + n_unsure)}
        return SimpleNamespace(
            num_reg_images=lambda: len(errors),
            num_points3D=lambda: 1,
            compute_mean_reprojection_error=lambda: 0.3,
            errors=errors,
            left=left and model(*left),
        )

    def run(*models, agreement=1.0):
        mapper, found = mapper_of(), [model(*each) for each in models]
        mapper.scratch = tmp_path
        monkeypatch.setattr(Mapper, "_map", lambda *_: [found.pop(0)])
        judge = lambda model, *_: (agreement, 50) if len(model.errors) else (0.0, 0)  # noqa: E731
        monkeypatch.setattr(mapping, "measure_agreement", judge)
        monkeypatch.setattr(
            mapper, "_register_again", lambda *_: mapper._attempt("again", "", mapper.database)
        )
        return mapper.run()

    monkeypatch.setattr(mapping, "refine_model", lambda found, *_: found)
    monkeypatch.setattr(mapping, "image_ids", lambda _: range(N_PHOTOS))
    monkeypatch.setattr(mapping.pycolmap, "Reconstruction", lambda: model(0, 0))
    monkeypatch.setattr(mapping, "tree_errors", lambda model, *_: model.errors)
    monkeypatch.setattr(Mapper, "_without", lambda _, model, names: model.left)
    return run


def test_the_second_try_loses_no_camera(mapped_models, caplog):
    """It registers more, of which fewer stay once those are left out that are not known."""
    best, other = mapped_models((40, 5, (39, 0)), (50, 16, (30, 18, (28, 0))))
    assert (best.n_registered, other.n_registered) == (39, 28)
    assert len(best.left_out) == 5
    told = [record for record in caplog.records if record.levelname == "WARNING"]
    assert len(told) == 5, "photos that the other try leaves out are in the result"


def test_of_two_bent_models_the_one_that_loses_all_its_cameras_is_not_chosen(mapped_models):
    best, other = mapped_models((60, 0), (0, 60), agreement=0.85)
    assert (best.n_registered, other.n_registered) == (60, 0)


@pytest.mark.parametrize(
    "tries, n_found, starts",
    [
        ([[4, 5, 3], [9, 6], [11]], 11, [None, "8", "10"]),
        ([[4, 5, 3], [6]], 8, [None, "8"]),  # going on lost photos
        ([[4, 5, 3], [2]], 8, [None, "8"]),  # and found no model
        ([[5]], 5, [None]),
        ([[]], 0, [None]),
    ],
)
def test_what_is_joined_is_gone_on_with_until_that_brings_no_photo(
    monkeypatch, tmp_path, tries, n_found, starts
):
    """Models of 5, 4 and 3 photos that share some make 8; the largest takes in the others."""

    def model(n_photos=0):
        found = SimpleNamespace(n_photos=n_photos, num_points3D=lambda: 1)
        found.num_reg_images = lambda: found.n_photos
        found.write = lambda folder: (folder / "model").write_text(str(found.n_photos))
        return found

    given, asked = [list(map(model, each)) for each in tries], []

    def map_photos(_, database, folder, start):
        folder.mkdir(parents=True)
        asked.append(start and (start / "model").read_text())
        return given.pop(0)

    def join(models):
        whole, *others = models
        whole.n_photos += len(others) + (len(others) > 1)
        return whole, []

    mapper = mapper_of()
    monkeypatch.setattr(Mapper, "_map", map_photos)
    monkeypatch.setattr(mapping, "join_models", join)
    monkeypatch.setattr(mapping.pycolmap, "Reconstruction", model)
    found, others = mapper._map_joined(None, tmp_path / "incremental")
    assert found.n_photos == n_found and not others
    assert asked == starts and not given
