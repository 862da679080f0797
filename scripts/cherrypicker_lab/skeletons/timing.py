"""How time and memory grow with the cloud; each size is measured in a process of its own."""

import logging
import time

from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.graph.extract import extract_skeleton
from cherrypicker.traits.measure import measure_traits
from cherrypicker_lab.skeletons.graph_scores import score_points
from cherrypicker_lab.skeletons.methods import few_points, peak_mb

logger = logging.getLogger(__name__)


def time_stages(cloud, skeleton):
    """CPU seconds and memory from a labelled cloud to its traits, with the default settings.

    All stages run on 3000 of the points first, which compiles and loads their functions; the
    stages' own start (imports) is not counted either.

    Parameters
    ----------
    cloud : PointCloud
    skeleton : Skeleton
        The truth, for the Chamfer distance.

    Returns
    -------
    dict
        ``n_points``, ``n_contracted``, ``chamfer_cm2``, CPU seconds of ``contract``, ``graph`` and
        ``traits``, ``contract_peak_mb`` and ``peak_mb`` (of the process so far).
    """
    _cloud_to_traits(few_points(cloud))
    contracted, seconds, contract_peak_mb = _cloud_to_traits(cloud)
    return {
        "n_points": len(cloud),
        "n_contracted": len(contracted),
        **score_points(contracted.points, skeleton),
        **seconds,
        "contract_peak_mb": contract_peak_mb,
        "peak_mb": peak_mb(),
    }


def _cloud_to_traits(cloud):
    """Contracted cloud, CPU seconds of each stage, and the memory's peak up to the contraction."""
    seconds, clock = {}, time.process_time()

    def lap(stage):
        nonlocal clock
        seconds[stage], clock = time.process_time() - clock, time.process_time()
        logger.info("%s: %.2f CPU s", stage, seconds[stage])

    contracted, details = contract_wood(cloud)
    lap("contract")
    contract_peak_mb = peak_mb()
    found = extract_skeleton(contracted, cloud, base=details["base"], limbs=details["limbs"])
    lap("graph")
    measure_traits(found, cloud)
    lap("traits")
    return contracted, seconds, contract_peak_mb
