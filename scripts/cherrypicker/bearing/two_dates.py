"""Ages by two dates of a series: wood that the earlier scan lacks has grown since."""

from datetime import date
from pathlib import Path

import numpy as np

from cherrypicker.bearing.measure import COLUMNS, measure_bearing
from cherrypicker.bearing.rates import read_rates
from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.series.changes import odds_of_gone, share_missed
from cherrypicker.series.compare import Step
from cherrypicker.traits.branches import read_branches
from cherrypicker.traits.table import LIMB_COLUMNS

#: Of the series' ``bearing.csv``: those of a tree's own, after whose they are.
DATED_COLUMNS = ("series_branch_id", "tree", "date", *COLUMNS)
# Of wood that tells its season once. Chosen on 12 trees; 0.03 and 0.12 tell ages and shoots worse
# (docs/lab/bearing.md)
RUN_M = 0.06


def seasons_between(step: Step) -> int:
    """Growing seasons between two scans of a leafless tree: years, rounded.

    Raises
    ------
    StageError
        If a date is no ISO date.
    """
    try:
        first, last = (date.fromisoformat(scan.date) for scan in (step.earlier, step.later))
    except ValueError as error:
        cause = f"no ISO dates: {step.earlier.date!r}, {step.later.date!r}"
        raise StageError(cause, key="date in trees.tsv") from error
    return round((last - first).days / 365.25)


def odds_of_ages(step: Step, n_seasons: int, n_ages: int) -> np.ndarray:
    """What the earlier scan says of the ages of the later wood, (n_nodes, n_ages) float64.

    Log odds a metre, by node of the later skeleton, of what the earlier scan shows if the wood has
    this age, to wood that stood there. Between the scans lie ``n_seasons`` growing seasons; ages
    are told apart in years from 1, and the last is open.
    """
    wood = step.later.wood
    is_old = step.new.piece < 0
    odds = odds_of_gone(is_old, share_missed(wood, step.was_there, is_old))[wood.at_node] / RUN_M
    return np.where(np.arange(n_ages) < n_seasons, odds[:, None], 0.0)


def bearing_by_two_dates(
    step: Step, ids: np.ndarray, folder: Path
) -> tuple[dict | None, list[dict]]:
    """Tell the bearing wood of the later scan of a step, whose results are in a folder.

    Its axes have the lasting ``ids`` (n_axes,), int64. Returns totals as of ``bearing.json``, None
    where no season lies between, or more than ages are told, and rows of `DATED_COLUMNS`.
    """
    n_ages, n_seasons = read_rates().n_ages, seasons_between(step)
    if not 0 < n_seasons < n_ages:
        return None, []
    totals, pieces = measure_bearing(
        read_measured_tree(folder),
        read_branches(folder / "limbs.csv", LIMB_COLUMNS),
        read_json(folder / "traits.json").get("tcsa_cm2"),
        odds_of_ages(step, n_seasons, n_ages),
    )
    about = {"tree": step.later.tree, "date": step.later.date}
    rows = [{"series_branch_id": int(ids[row["branch_id"]])} | about | row for row in pieces]
    return {"seasons": n_seasons} | totals, rows
