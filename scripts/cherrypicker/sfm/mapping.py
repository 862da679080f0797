"""From verified matches to one model, and once more for photos that it does not place."""

import logging
import os
import shutil
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import pycolmap

from cherrypicker.photos import MIN_PHOTOS
from cherrypicker.progress import Progress
from cherrypicker.sfm.agreement import measure_agreement, read_verified_pairs
from cherrypicker.sfm.database import forget_focal_lengths, image_ids
from cherrypicker.sfm.export import registered_photos
from cherrypicker.sfm.features import Search, SearchOptions
from cherrypicker.sfm.joining import join_models
from cherrypicker.sfm.matching import match_pooled
from cherrypicker.sfm.refine import adjust, refine_model
from cherrypicker.sfm.uncertainty import tree_errors

logger = logging.getLogger(__name__)
# Share of the verified pairs that fit a model, or it is bent: straight ones of seven trees have
# 0.96 and more, a ring that was bent on purpose less than 0.7 (test)
MIN_AGREEMENT = 0.9


@dataclass(frozen=True)
class MappingOptions(SearchOptions):
    """How the model is built; the fields are config keys of ``sfm``."""

    min_registered_fraction: float = 0.5
    max_camera_error_px: float = 1.5


@dataclass(frozen=True)
class Attempt:
    """The largest model of one way to build it, with what was joined to it."""

    name: str
    reason: str  # what is done differently, for the log
    model: pycolmap.Reconstruction  # without photos where nothing registered
    agreement: float  # share of the verified pairs of its photos that fit it
    n_pairs: int  # these pairs
    other_models: list[list[str]]  # photo names of the models that nothing joined
    n_photos: int  # photos in the database
    database: Path  # the matches that it was built from
    # Errors of the cameras at the tree, px, and of those that it lost for theirs
    errors: Mapping[str, float]
    left_out: Mapping[str, float]

    @property
    def n_registered(self) -> int:
        return self.model.num_reg_images()

    @property
    def n_placed(self) -> int:
        """Photos that the mapper placed, known or not."""
        return self.n_registered + len(self.left_out)

    def __str__(self) -> str:
        return (
            f"{self.n_registered} of {self.n_photos} photos registered, "
            f"{100 * self.agreement:.0f} % of {self.n_pairs} verified pairs fit, "
            f"{self.model.compute_mean_reprojection_error():.2f} px"
        )


@dataclass
class Mapper:
    """Build a model of one scan; photos whose cameras are not known are tried a second time."""

    database: Path  # with verified matches. COLMAP changes it: pass a copy
    photos: Path  # folder of the photos, for pooled descriptors and the colours of the points
    scratch: Path  # folder for temporary files
    options: MappingOptions
    masks: str | os.PathLike | None = None  # folder of prepared masks
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        # They judge every model. Those of photos matched again are more, but some pairs have wrong
        # ones only
        self.pairs = read_verified_pairs(self.database)
        # Error of a camera that is allowed, px of the photo as stored. The key counts pixels at the
        # size at which features are sought: larger photos show no more
        with pycolmap.Database.open(self.database) as opened:
            longest = max(max(camera.width, camera.height) for camera in opened.read_all_cameras())
        size = self.options.max_image_size_px or longest
        self.limit_px = self.options.max_camera_error_px * max(1.0, longest / size)

    def run(self) -> list[Attempt]:
        """Return both attempts, or the only one, the better first: by what is left of each."""
        first = self._attempt("incremental", "as configured", self.database)
        attempts = [first]
        known = self._known(first)
        if len(known) < first.n_photos:
            attempts.append(self._register_again(first, known))
        attempts.sort(key=self._worth, reverse=True)
        for photo, error in sorted(attempts[0].left_out.items()):
            logger.warning("%s is left out: its camera is off by %.1f px", photo, error)
        return attempts

    def _attempt(self, name: str, reason: str, database: Path) -> Attempt:
        """Map a database, refine the joined model and take out what is not known."""
        logger.info("mapping attempt '%s': %s", name, reason)
        model, others = self._map_joined(database, self.scratch / name)
        if model.num_reg_images():
            logger.info("attempt '%s': %d photos registered", name, model.num_reg_images())
            model = refine_model(model, database, self.seed, self.threads)
        known, errors, left_out = self._leave_out(model)
        judged = known if errors else model  # of one that loses all its cameras, what it was
        attempt = Attempt(
            name,
            reason,
            known,
            *measure_agreement(judged, self.pairs),
            other_models=[[image.name for image in registered_photos(each)] for each in others],
            n_photos=len(image_ids(database)),
            database=database,
            errors=errors,
            left_out=left_out,
        )
        logger.info("attempt '%s' with all cameras that are known: %s", name, attempt)
        return attempt

    def _worth(self, attempt: Attempt) -> tuple[bool, bool, int]:
        """What makes an attempt better: enough photos placed, not bent, cameras that are known."""
        is_enough = attempt.n_placed >= self.options.min_registered_fraction * attempt.n_photos
        return is_enough, not self._is_bent(attempt), len(self._known(attempt))

    def _is_bent(self, attempt: Attempt) -> bool:
        """Whether too many of the verified pairs contradict a model."""
        return attempt.n_pairs > 0 and attempt.agreement < MIN_AGREEMENT

    def _known(self, attempt: Attempt) -> set[str]:
        """Photos whose cameras are known; none of a bent model."""
        return set() if self._is_bent(attempt) else {*attempt.errors}

    def _register_again(self, first: Attempt, known: set[str]) -> Attempt:
        """Match anew the photos whose cameras are not known, and map all once more."""
        database = Path(shutil.copyfile(first.database, self.scratch / "again.db"))
        unknown = image_ids(database).keys() - known
        logger.warning(
            f"{first}; {len(unknown)} cameras do not fit or are not known within {self.limit_px:g} "
            f"px; matching these again: {', '.join(sorted(unknown))}"
        )
        reason = "photos not known matched again, all mapped anew"
        if not first.n_placed:
            reason += ", focal lengths of EXIF data not believed"
            logger.warning(
                "no photo was placed; the second try does not believe EXIF focal lengths"
            )
            forget_focal_lengths(database)
        search = Search(self.photos, self.options, self.masks, self.threads)
        match_pooled(database, unknown, search, self.seed)
        again = self._attempt("again", reason, database)
        logger.info("known are %d cameras, before %d", len(self._known(again)), len(known))
        return again

    def _leave_out(
        self, model: pycolmap.Reconstruction
    ) -> tuple[pycolmap.Reconstruction, dict[str, float], dict[str, float]]:
        """Take out cameras that are not known, the worst first, until all that are left are.

        One that is off drags others along, so errors are told anew after those were left out that
        are at least half as unsure as the worst. Returns the model, and the errors of the cameras
        that it has, and of those that it has lost, px.
        """
        left_out: dict[str, float] = {}
        while model.num_reg_images():
            errors = tree_errors(model, self.seed, self.threads)
            largest = max(errors.values())  # without end where nothing holds a camera
            if largest <= self.limit_px:
                return model, errors, left_out
            unknown = {name: px for name, px in errors.items() if px > self.limit_px}
            worst = {name: px for name, px in unknown.items() if px >= largest / 2}
            left_out |= worst
            if len(worst) == len(errors):
                break
            model = self._without(model, worst)
        return pycolmap.Reconstruction(), {}, left_out

    def _without(
        self, model: pycolmap.Reconstruction, names: Collection[str]
    ) -> pycolmap.Reconstruction:
        """A model without some photos and what they alone hold, adjusted."""
        rest = pycolmap.Reconstruction(model)
        for image in registered_photos(rest):
            if image.name in names:
                rest.deregister_frame(image.frame_id)
        rest.tear_down()
        adjust(rest, threads=self.threads)
        return rest

    def _map_joined(
        self, database: Path, folder: Path
    ) -> tuple[pycolmap.Reconstruction, list[pycolmap.Reconstruction]]:
        """Map, join what shares photos and go on from there, while that brings photos.

        Returns the model, without photos where nothing registered, and those that nothing joins.
        """
        start = None
        best: tuple[pycolmap.Reconstruction, list] = pycolmap.Reconstruction(), []
        while True:
            models = self._map(database, folder, start)
            models = [each for each in models if each.num_reg_images() >= MIN_PHOTOS]
            models.sort(key=lambda each: (-each.num_reg_images(), -each.num_points3D()))
            n_best = best[0].num_reg_images()
            n_mapped = models[0].num_reg_images() if models else 0
            found = join_models(models) if models else best
            n_joined = found[0].num_reg_images()
            if n_joined < n_best:
                return best  # going on lost photos
            best = found
            if n_joined <= max(n_mapped, n_best):
                return best
            logger.info("mapping goes on from %d joined photos", n_joined)
            start, folder = folder / "joined", folder / "again"
            start.mkdir()
            best[0].write(start)

    def _map(
        self, database: Path, folder: Path, start: Path | None
    ) -> list[pycolmap.Reconstruction]:
        """Let COLMAP map incrementally, from the first two photos or a model on."""
        pycolmap.set_random_seed(self.seed)
        options = pycolmap.IncrementalPipelineOptions()
        options.random_seed, options.num_threads = self.seed, self.threads
        options.min_model_size = MIN_PHOTOS
        folder.mkdir(parents=True)
        with Progress(len(image_ids(database)), "photos registered") as bar:

            def step(n_photos: int = 1) -> None:
                # Photos tried twice, or in two models, count once.
                bar.step(min(n_photos, bar.total - bar.done))

            models = pycolmap.incremental_mapping(
                database,
                self.photos,
                folder,
                options,
                start or "",
                initial_image_pair_callback=lambda: step(2),
                next_image_callback=step,
            )
        return list(models.values())
