"""Two finished scans of a generated tree on two days, compared, beside what truly changed."""

from pathlib import Path

import numpy as np

from cherrypicker.files import read_json
from cherrypicker.geometry.similarity import fit_rigid
from cherrypicker.poses import read_poses
from cherrypicker.series.compare import compare_scans
from cherrypicker.series.scan_files import read_scan
from cherrypicker_lab.evaluation import pair_cameras
from cherrypicker_lab.orchard.grow.seasons import at_date
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.series.judge import judge_step


def true_target(truth):
    """Grow the target of a scene of `snakemake orchard` again, its nodes numbered.

    Parameters
    ----------
    truth : path-like
        The scene's folder ``truth``.

    Returns
    -------
    DatedTree
    """
    scene = read_json(Path(truth) / "scene.json")
    options = {name: value for name, value in scene["options"].items() if name != "season"}
    tree_seed = options.get("tree_seed", scene["seed"])
    target = generate_scene(scene["seed"], **options).target
    return at_date(target, scene["options"].get("season", "first"), tree_seed)


def frame_of(results, truth):
    """Turn and shift from the tree's frame to a finished scan's, by the cameras, (4, 4).

    Raises
    ------
    StageError
        If fewer than three photos bear the names of true ones.
    """
    found = read_poses(Path(results) / "metric_poses.npz")
    true = read_poses(Path(truth) / "poses.npz")
    here, there = pair_cameras(found.names, found.centers, true.names, true.centers)
    return fit_rigid(there, here, np.ones(len(here)))


def judge_scans(results, truths):
    """Compare two finished scans of one tree, and judge the comparison.

    Parameters
    ----------
    results, truths : sequence of two path-like
        Results folders and the scenes' folders ``truth``, the first date first.

    Returns
    -------
    dict
        See `judge.judge_step`.
    """
    scans = [read_scan(folder, name, name) for folder, name in zip(results, ("first", "second"))]
    trees = [true_target(truth) for truth in truths]
    frames = [frame_of(folder, truth) for folder, truth in zip(results, truths)]
    comparison = compare_scans(scans)
    return judge_step(comparison, *trees, scans[1].wood, frames[1], first_frame=frames[0])
