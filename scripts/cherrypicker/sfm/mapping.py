"""From verified matches to one model, in several attempts if need be."""

from __future__ import annotations

import logging
import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import pycolmap

from cherrypicker.progress import Progress
from cherrypicker.sfm.agreement import (
    Agreement,
    VerifiedPair,
    measure_agreement,
    read_verified_pairs,
)
from cherrypicker.sfm.database import image_ids, publish_database
from cherrypicker.sfm.features import FeatureOptions, extract_affine_features
from cherrypicker.sfm.matching import PairOptions, add_guided_matches, match_again
from cherrypicker.sfm.policies import (
    Policy,
    further_policies,
    global_options,
    incremental_options,
)
from cherrypicker.sfm.refine import adjust, drop_short_tracks, refine_model
from cherrypicker.sfm.rematch import RefineOptions

logger = logging.getLogger(__name__)

# Scores that differ by less are as good: the earlier attempt stays, and so does the refined model
# (guess)
SCORE_MARGIN = 0.01


@dataclass(frozen=True)
class MappingOptions(PairOptions):
    """How the model is built; the fields are config keys of ``sfm``."""

    mapper: str = "incremental"
    min_registered_fraction: float = 0.5
    wanted_registered_fraction: float = 0.95
    wanted_pair_agreement: float = 0.9
    max_attempts: int = 5
    # Of the affine features that some attempts look for
    max_features: int = 4000
    max_image_size_px: int = 2400


@dataclass(frozen=True)
class Attempt:
    """The largest model of one attempt."""

    policy: Policy
    model: pycolmap.Reconstruction | None  # none where nothing registered
    agreement: Agreement | None
    other_models: tuple[tuple[str, ...], ...]  # photo names of the smaller models
    n_photos: int  # photos in the database

    @property
    def n_registered(self) -> int:
        return 0 if self.model is None else self.model.num_reg_images()

    @property
    def fraction(self) -> float:
        return self.n_registered / max(self.n_photos, 1)

    @property
    def score(self) -> float:
        """Share of photos times share of matches that the model explains."""
        return 0.0 if self.agreement is None else self.fraction * self.agreement.matches


def map_photos(
    database: Path,
    photos: Path,
    scratch: Path,
    options: MappingOptions,
    refining: RefineOptions,
    *,
    masks: str | os.PathLike | None = None,
    seed: int = 0,
    threads: int = 1,
) -> list[Attempt]:
    """Build a model; where it lacks photos or contradicts the matches, try other ways.

    Parameters
    ----------
    database : Path
        Database with verified matches. COLMAP changes it: pass a copy.
    photos : Path
        Folder of the photos, for affine features and the colours of the points.
    masks : path-like, optional
        Folder of prepared masks: what is black gives no features.

    Returns
    -------
    list of Attempt
        The chosen one first, the others in the order tried.
    """
    mapper = _Mapper(
        *(database, photos, scratch, options, refining, read_verified_pairs(database), masks),
        *(seed, threads),
    )
    attempts = [mapper.attempt(Policy(options.mapper, options.mapper, "as configured"))]
    further: list[Policy] = []
    if not _good_enough(attempts[0], options):
        with pycolmap.Database.open(database) as opened:
            has_exif_focal = any(cam.has_prior_focal_length for cam in opened.read_all_cameras())
        further = further_policies(
            options.mapper,
            options.max_epipolar_error_px,
            too_few=attempts[0].fraction < options.wanted_registered_fraction,
            has_exif_focal=has_exif_focal,
        )
    for policy in further[: options.max_attempts - 1]:
        logger.warning("%s; trying again: %s", _complaint(attempts[-1], options), policy.reason)
        attempts.append(mapper.attempt(policy))
        if _good_enough(attempts[-1], options):
            break
    best = attempts[0]
    for attempt in attempts[1:]:
        if attempt.score > best.score + SCORE_MARGIN:
            best = attempt
    if len(attempts) > 1:
        logger.warning("kept the model of attempt '%s': %s", best.policy.name, _verdict(best))
    others = [attempt for attempt in attempts if attempt is not best]
    if best.model is not None:
        # Poses that took several attempts guide worse
        best = mapper.refine(best, best.model, n_rounds=1 if len(attempts) == 1 else 2)
        logger.info("after the last adjustment: %s", _verdict(best))
    return [best, *others]


@dataclass(frozen=True)
class _Mapper:
    """What all attempts on one scan share; ``pairs`` are those of the matching."""

    database: Path
    photos: Path
    scratch: Path
    options: MappingOptions
    refining: RefineOptions
    pairs: list[VerifiedPair]
    masks: str | os.PathLike | None
    seed: int
    threads: int

    def attempt(self, policy: Policy) -> Attempt:
        """Run one policy on a database of its own and keep the largest model."""
        logger.info("mapping attempt '%s': %s", policy.name, policy.reason)
        folder = self.scratch / policy.name
        folder.mkdir()
        working = folder / "database.db"
        shutil.copyfile(self._features_of(policy), working)
        if not policy.trust_exif_focal:
            forget_focal_lengths(working)
        if policy.recheck_error_px > 0:
            self._verify_again(working, policy.recheck_error_px)
        if policy.guided:
            add_guided_matches(working, self.options, seed=self.seed, threads=self.threads)
        pycolmap.set_random_seed(self.seed)
        run = self._run_incremental if policy.mapper == "incremental" else self._run_global
        models = run(policy, working, folder)
        n_photos = len(image_ids(working))
        working.unlink()
        models.sort(key=lambda each: (-each.num_reg_images(), -each.num_points3D()))
        attempt = Attempt(policy, None, None, (), n_photos)
        if models:
            others = tuple(registered_names(each) for each in models[1:])
            attempt = Attempt(policy, models[0], self.judge(models[0]), others, n_photos)
        logger.info("attempt '%s': %s", policy.name, _verdict(attempt))
        return attempt

    def judge(self, model: pycolmap.Reconstruction) -> Agreement:
        """How well the verified pairs fit a model."""
        return measure_agreement(model, self.pairs, self.options.max_epipolar_error_px)

    def refine(self, best: Attempt, model: pycolmap.Reconstruction, n_rounds: int) -> Attempt:
        """Refine the chosen model, unless the verified pairs then fit it less well."""
        adjusted = pycolmap.Reconstruction(model)
        adjust(adjusted, self.refining, threads=self.threads)
        before = self.judge(adjusted)
        model, limit = adjusted, self.options.max_epipolar_error_px
        files = self._features_of(best.policy), self.scratch
        for _ in range(n_rounds):
            model = refine_model(
                model, *files, limit, self.refining, seed=self.seed, threads=self.threads
            )
        agreement = self.judge(model)
        if agreement.matches < before.matches - SCORE_MARGIN:
            logger.warning("matching by poses took the model off the verified pairs: left out")
            model, agreement = adjusted, before
        drop_short_tracks(model)
        return replace(best, model=model, agreement=agreement)

    def _features_of(self, policy: Policy) -> Path:
        """The database with the features and verified matches that a policy starts from."""
        if not policy.affine:
            return self.database
        made = self.scratch / "affine.db"
        if not made.is_file():
            working = shutil.copyfile(self.database, self.scratch / "affine_working.db")
            wanted = FeatureOptions(
                max_features=self.options.max_features,
                max_image_size_px=self.options.max_image_size_px,
            )
            extract_affine_features(
                working, self.photos, wanted, masks=self.masks, threads=self.threads
            )
            match_again(working, self.options, seed=self.seed, threads=self.threads)
            publish_database(working, made)
        return made

    def _verify_again(self, database: Path, max_error_px: float) -> None:
        with pycolmap.Database.open(database) as opened:
            pair_ids, geometries = opened.read_two_view_geometries()
            for pair_id, geometry in zip(pair_ids, geometries):
                if len(geometry.inlier_matches):  # keeps what guided matching added
                    first, second = pycolmap.pair_id_to_image_pair(pair_id)
                    if opened.exists_matches(first, second):
                        opened.delete_matches(first, second)
                    opened.write_matches(first, second, geometry.inlier_matches)
            opened.clear_two_view_geometries()
        verifier = pycolmap.GeometricVerifierOptions()
        verifier.num_threads = self.threads
        limits = replace(self.options, max_epipolar_error_px=max_error_px).verification(self.seed)
        pycolmap.geometric_verification(database, verifier, two_view_geometry_options=limits)

    def _run_incremental(
        self, policy: Policy, database: Path, folder: Path
    ) -> list[pycolmap.Reconstruction]:
        with Progress(len(image_ids(database)), "photos registered") as bar:

            def step(n_photos: int = 1) -> None:
                # Photos tried twice, or in two models, count once.
                bar.step(min(n_photos, bar.total - bar.done))

            models = pycolmap.incremental_mapping(
                database,
                self.photos,
                folder,
                incremental_options(policy, self.seed, self.threads),
                initial_image_pair_callback=lambda: step(2),
                next_image_callback=step,
            )
        return list(models.values())

    def _run_global(
        self, policy: Policy, database: Path, folder: Path
    ) -> list[pycolmap.Reconstruction]:
        with pycolmap.Database.open(database) as opened:
            calibrated = all(camera.has_prior_focal_length for camera in opened.read_all_cameras())
        if not calibrated:
            calibration = pycolmap.ViewGraphCalibrationOptions()
            calibration.random_seed = self.seed
            pycolmap.calibrate_view_graph(database, calibration)
        wanted = global_options(self.seed, self.threads, self.photos)
        return list(pycolmap.global_mapping(database, self.photos, folder, wanted).values())


def _good_enough(attempt: Attempt, options: MappingOptions) -> bool:
    return (
        attempt.agreement is not None
        and attempt.fraction >= options.wanted_registered_fraction
        and attempt.agreement.pairs >= options.wanted_pair_agreement
    )


def _verdict(attempt: Attempt) -> str:
    if attempt.model is None or attempt.agreement is None:
        return "no photo registered"
    return (
        f"{attempt.n_registered} of {attempt.n_photos} photos registered, "
        f"{100 * attempt.agreement.pairs:.0f} % of {attempt.agreement.n_pairs} verified pairs fit, "
        f"{attempt.model.compute_mean_reprojection_error():.2f} px"
    )


def _complaint(attempt: Attempt, options: MappingOptions) -> str:
    if attempt.agreement is None or attempt.fraction < options.wanted_registered_fraction:
        return (
            f"only {attempt.n_registered} of {attempt.n_photos} photos registered "
            f"(sfm.wanted_registered_fraction {options.wanted_registered_fraction:g})"
        )
    return (
        f"only {100 * attempt.agreement.pairs:.0f} % of {attempt.agreement.n_pairs} verified pairs "
        f"fit the model, which may be bent "
        f"(sfm.wanted_pair_agreement {options.wanted_pair_agreement:g})"
    )


def registered_names(model: pycolmap.Reconstruction) -> tuple[str, ...]:
    """Return the names of the photos that have a pose, sorted."""
    return tuple(sorted(image.name for image in model.images.values() if image.has_pose))


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
