"""From verified matches to one model, in several attempts if need be."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import pycolmap

from cherrypicker.progress import Progress
from cherrypicker.sfm.agreement import Agreement, measure_agreement, read_verified_pairs
from cherrypicker.sfm.database import image_ids
from cherrypicker.sfm.export import registered_photos
from cherrypicker.sfm.features import SearchOptions
from cherrypicker.sfm.matching import PairOptions, add_guided_matches, match_pooled
from cherrypicker.sfm.photo_files import MIN_PHOTOS
from cherrypicker.sfm.refine import (
    RefineOptions,
    adjust,
    drop_photos,
    drop_short_tracks,
    refine_model,
)
from cherrypicker.sfm.uncertainty import tree_errors

logger = logging.getLogger(__name__)

# Scores that differ by less are as good: the earlier attempt stays, and so does the refined model
# (guess)
SCORE_MARGIN = 0.01


@dataclass(frozen=True)
class MappingOptions(PairOptions, SearchOptions):
    """How the model is built; the fields are config keys of ``sfm``."""

    mapper: str = "incremental"
    min_registered_fraction: float = 0.5
    wanted_registered_fraction: float = 0.95
    wanted_pair_agreement: float = 0.9
    max_attempts: int = 5
    max_camera_error_px: float = 1.5


@dataclass(frozen=True)
class Policy:
    """One way to build a model from the verified matches."""

    name: str
    mapper: str  # {"incremental", "global"}
    reason: str  # what the policy does differently, for the log
    pooled: bool = False  # match the photos that are missing anew first, by pooled descriptors
    trust_exif_focal: bool = True  # false starts every focal length from 1.2 times the longer side


@dataclass(frozen=True)
class Attempt:
    """The largest model of one attempt."""

    policy: Policy
    model: pycolmap.Reconstruction  # without photos where nothing registered
    agreement: Agreement
    other_models: list[list[str]]  # photo names of the smaller models
    n_photos: int  # photos in the database
    database: Path  # the matches that it was built from
    # Of the chosen one: errors of the cameras at the tree, px, and of those that it lost for theirs
    errors: Mapping[str, float] = field(default_factory=dict)
    left_out: Mapping[str, float] = field(default_factory=dict)

    @property
    def n_registered(self) -> int:
        return self.model.num_reg_images()

    @property
    def fraction(self) -> float:
        return self.n_registered / max(self.n_photos, 1)

    @property
    def score(self) -> float:
        """Share of photos times share of matches that the model explains."""
        return self.fraction * self.agreement.matches

    def __str__(self) -> str:
        return (
            f"{self.n_registered} of {self.n_photos} photos registered, "
            f"{100 * self.agreement.pairs:.0f} % of {self.agreement.n_pairs} verified pairs fit, "
            f"{self.model.compute_mean_reprojection_error():.2f} px"
        )


@dataclass
class Mapper:
    """Build a model of one scan, in other ways where it lacks photos or contradicts the matches."""

    database: Path  # with verified matches. COLMAP changes it: pass a copy
    photos: Path  # folder of the photos, for pooled descriptors and the colours of the points
    scratch: Path  # folder for temporary files
    options: MappingOptions
    refining: RefineOptions
    masks: str | os.PathLike | None = None  # folder of prepared masks
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        # They judge every model. Guided matches, which may be added later, are twice as many, but
        # some pairs have wrong ones only
        self.pairs = read_verified_pairs(self.database)
        # Error of a camera that is allowed, px of the photo as stored
        self.limit_px = largest_error_px(self.database, self.options)

    def run(self) -> list[Attempt]:
        """Return all attempts, the chosen one first, the others in the order tried."""
        attempts = [
            self._attempt(Policy(self.options.mapper, self.options.mapper, "as configured"))
        ]
        if not self._is_good(attempts[0]):
            self._try_further(attempts)
        best = attempts[0]
        for attempt in attempts[1:]:
            if attempt.score > best.score + SCORE_MARGIN:
                best = attempt
        if len(attempts) > 1:
            logger.warning("kept the model of attempt '%s': %s", best.policy.name, best)
        others = [attempt for attempt in attempts if attempt is not best]
        if not best.n_registered:
            return [best, *others]
        # Poses that took several attempts guide worse
        best = self._refine(best, n_rounds=1 if len(attempts) == 1 else 2)
        logger.info("after the last adjustment: %s", best)
        again = self._try_unknown_again(best) if self.options.max_attempts > 1 else None
        if again is not None:
            best, others = again, [*others, best]
        return [self._leave_out(best), *others]

    def _is_good(self, attempt: Attempt) -> bool:
        return (
            attempt.n_registered > 0
            and attempt.fraction >= self.options.wanted_registered_fraction
            and attempt.agreement.pairs >= self.options.wanted_pair_agreement
        )

    def _try_further(self, attempts: list[Attempt]) -> None:
        """Add attempts by other policies until one is good."""
        first = attempts[0]
        with pycolmap.Database.open(self.database) as opened:
            has_exif_focal = any(cam.has_prior_focal_length for cam in opened.read_all_cameras())
        further = further_policies(
            self.options.mapper,
            too_few=first.fraction < self.options.wanted_registered_fraction,
            has_exif_focal=has_exif_focal,
        )
        # From here on: "guided" is the first attempt again over what this adds
        add_guided_matches(self.database, self.options, seed=self.seed, threads=self.threads)
        for policy in further[: self.options.max_attempts - 1]:
            logger.warning(
                "%s (sfm.wanted_registered_fraction %g, sfm.wanted_pair_agreement %g); "
                "trying again: %s",
                attempts[-1],
                self.options.wanted_registered_fraction,
                self.options.wanted_pair_agreement,
                policy.reason,
            )
            attempts.append(
                self._attempt(policy, [image.name for image in registered_photos(first.model)])
            )
            if self._is_good(attempts[-1]):
                break

    def _attempt(self, policy: Policy, registered: Collection[str] = ()) -> Attempt:
        """Run one policy on a database of its own and keep the largest model.

        Parameters
        ----------
        registered : collection of str
            Photos that need no further matches.
        """
        logger.info("mapping attempt '%s': %s", policy.name, policy.reason)
        folder = self.scratch / policy.name
        folder.mkdir()
        working = folder / "database.db"
        shutil.copyfile(self.database, working)
        names = set(image_ids(working))
        if not policy.trust_exif_focal:
            forget_focal_lengths(working)
        if policy.pooled:
            self._match_pooled(working, names - set(registered))
        pycolmap.set_random_seed(self.seed)
        run = self._run_incremental if policy.mapper == "incremental" else self._run_global
        models = run(working, folder) or [pycolmap.Reconstruction()]
        models.sort(key=lambda each: (-each.num_reg_images(), -each.num_points3D()))
        others = [[image.name for image in registered_photos(each)] for each in models[1:]]
        attempt = Attempt(policy, models[0], self._judge(models[0]), others, len(names), working)
        logger.info("attempt '%s': %s", policy.name, attempt)
        return attempt

    def _judge(self, model: pycolmap.Reconstruction) -> Agreement:
        """How well the verified pairs fit a model."""
        return measure_agreement(model, self.pairs, self.options.max_epipolar_error_px)

    def _refine(self, attempt: Attempt, n_rounds: int) -> Attempt:
        """Refine the chosen model, unless the verified pairs then fit it less well."""
        adjusted = pycolmap.Reconstruction(attempt.model)
        adjust(adjusted, self.refining, threads=self.threads)
        before = self._judge(adjusted)
        model, limit = adjusted, self.options.max_epipolar_error_px
        how = self.refining, self.seed, self.threads
        for _ in range(n_rounds):
            model = refine_model(model, attempt.database, limit, *how)
        agreement = self._judge(model)
        if agreement.matches < before.matches - SCORE_MARGIN:
            logger.warning("matching by poses took the model off the verified pairs: left out")
            model, agreement = adjusted, before
        drop_short_tracks(model)
        errors = self._errors(model)
        return replace(attempt, model=model, agreement=agreement, errors=errors)

    def _try_unknown_again(self, best: Attempt) -> Attempt | None:
        """Match anew the photos whose cameras are not known, and register them once more.

        Returns
        -------
        Attempt or None
            None where all are known, or where no more are known afterwards.
        """
        known = {name for name, error in best.errors.items() if error <= self.limit_px}
        database = self.scratch / "again.db"
        shutil.copyfile(best.database, database)
        unknown = set(image_ids(database)) - known
        if not unknown:
            return None
        logger.warning(
            "the cameras of %d photos are not known within %g px; matching these again: %s",
            len(unknown),
            self.limit_px,
            ", ".join(sorted(unknown)),
        )
        self._match_pooled(database, unknown)
        start = pycolmap.Reconstruction(best.model)
        drop_photos(start, unknown)
        adjust(start, self.refining, threads=self.threads)
        policy = Policy("again", "incremental", "photos not known matched and registered again")
        folder = self.scratch / policy.name
        folder.mkdir()
        models = self._run_incremental(database, folder, start if known else None)
        if not models:
            return None
        model = max(models, key=lambda each: each.num_reg_images())
        again = replace(best, policy=policy, database=database, model=model)
        again = self._refine(again, n_rounds=1)
        n_known = sum(error <= self.limit_px for error in again.errors.values())
        logger.info("known are %d cameras, before %d", n_known, len(known))
        return again if n_known > len(known) else None

    def _leave_out(self, best: Attempt) -> Attempt:
        """Take out cameras that are not known, the worst first, until all that are left are.

        One that is off drags others along, so errors are told anew after those were left out that
        are at least half as unsure as the worst.
        """
        model, errors = pycolmap.Reconstruction(best.model), dict(best.errors)
        left_out: dict[str, float] = {}
        while errors and max(errors.values()) > self.limit_px:
            least = max(self.limit_px, max(errors.values()) / 2)
            worst = {name: error for name, error in errors.items() if error > least}
            left_out |= worst
            if len(worst) == len(errors):
                model, errors = pycolmap.Reconstruction(), {}
                break
            for name, error in sorted(worst.items()):
                logger.warning("left out: %s: its camera is known within %.1f px", name, error)
            drop_photos(model, worst)
            adjust(model, self.refining, threads=self.threads)
            errors = self._errors(model)
        agreement = self._judge(model)
        return replace(best, model=model, agreement=agreement, errors=errors, left_out=left_out)

    def _errors(self, model: pycolmap.Reconstruction) -> dict[str, float]:
        return tree_errors(model, self.refining, seed=self.seed, threads=self.threads)

    def _match_pooled(self, database: Path, names: Collection[str]) -> None:
        match_pooled(
            database,
            self.photos,
            names,
            self.options,
            self.options,
            masks=self.masks,
            seed=self.seed,
            threads=self.threads,
        )

    def _run_incremental(
        self, database: Path, folder: Path, start: pycolmap.Reconstruction | None = None
    ) -> list[pycolmap.Reconstruction]:
        """Map incrementally, from a model on where one is given."""
        options = pycolmap.IncrementalPipelineOptions()
        options.random_seed = options.mapper.random_seed = self.seed
        options.triangulation.random_seed = self.seed
        options.num_threads = options.mapper.num_threads = self.threads
        options.min_model_size = MIN_PHOTOS
        begun = folder / "start"
        if start is not None:
            begun.mkdir()
            start.write_binary(begun)
        with Progress(len(image_ids(database)), "photos registered") as bar:

            def step(n_photos: int = 1) -> None:
                # Photos tried twice, or in two models, count once.
                bar.step(min(n_photos, bar.total - bar.done))

            models = pycolmap.incremental_mapping(
                database,
                self.photos,
                folder,
                options,
                input_path=begun if start is not None else "",
                initial_image_pair_callback=lambda: step(2),
                next_image_callback=step,
            )
        return list(models.values())

    def _run_global(self, database: Path, folder: Path) -> list[pycolmap.Reconstruction]:
        with pycolmap.Database.open(database) as opened:
            calibrated = all(camera.has_prior_focal_length for camera in opened.read_all_cameras())
        if not calibrated:
            calibration = pycolmap.ViewGraphCalibrationOptions()
            calibration.random_seed = self.seed
            pycolmap.calibrate_view_graph(database, calibration)
        options = pycolmap.GlobalPipelineOptions()
        options.num_threads = options.mapper.num_threads = self.threads
        options.random_seed = options.mapper.random_seed = self.seed
        options.mapper.rotation_averaging.random_seed = self.seed
        options.mapper.global_positioning.random_seed = self.seed
        options.mapper.global_positioning.use_gpu = False
        options.mapper.bundle_adjustment.ceres.use_gpu = False
        options.image_path = self.photos
        return list(pycolmap.global_mapping(database, self.photos, folder, options).values())


def further_policies(mapper: str, *, too_few: bool, has_exif_focal: bool) -> list[Policy]:
    """Return what to try when the configured way fails, the most promising first.

    Parameters
    ----------
    too_few : bool
        True where photos are missing from the model, False where the model contradicts the matches.
    has_exif_focal : bool
        Whether some focal length came from EXIF, which may be wrong.
    """
    if too_few:
        reason = "the missing photos matched anew by pooled descriptors"
        policies = [
            Policy("guided", mapper, "verified pairs matched again along their epipolar lines"),
            Policy("pooled", mapper, reason, pooled=True),
        ]
    else:
        other = "global" if mapper == "incremental" else "incremental"
        policies = [Policy(other, other, f"the {other} mapper")]
    if has_exif_focal:
        reason = "EXIF focal lengths ignored"
        policies.append(Policy("no_exif_focal", mapper, reason, trust_exif_focal=False))
    return policies


def largest_error_px(database: Path, options: MappingOptions) -> float:
    """Error of a camera that is allowed, px of the photo as stored.

    The key counts pixels at the size at which features are sought: larger photos show no more.
    """
    with pycolmap.Database.open(database) as opened:
        longest = max(max(camera.width, camera.height) for camera in opened.read_all_cameras())
    size = options.max_image_size_px or longest
    return options.max_camera_error_px * max(1.0, longest / size)


def forget_focal_lengths(database: Path) -> None:
    """Set every focal length to COLMAP's guess without EXIF, 1.2 times the longer side."""
    factor = pycolmap.ImageReaderOptions().default_focal_length_factor
    with pycolmap.Database.open(database) as opened:
        for camera in opened.read_all_cameras():
            params = list(camera.params)
            for index in camera.focal_length_idxs():
                params[index] = factor * max(camera.width, camera.height)
            camera.params = params
            camera.has_prior_focal_length = False
            opened.update_camera(camera)
