"""What each stage costs, by the table ``stage_costs.yaml`` beside this file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from cherrypicker.files import load_schema
from cherrypicker.mvs.backends.table import BACKENDS

# Photos below this size are enlarged fourfold for their features, see sfm/features.py
ENLARGED_BELOW_MP = 2.0
# Points of the cloud per pixel of all depth maps: 0.013 to 0.017 were measured on 48 to 86 photos;
# this leaves room. At most, where bare ground keeps its points: 0.048 to 0.099, and 0.19 on the
# rehearsal's 250 photos
POINTS_PER_PIXEL = 0.03
MOST_POINTS_PER_PIXEL = 0.20
# How many of them the crop leaves: 0.8 to 0.9; of a cloud with all of its points half at most
CROPPED_SHARE = 0.85
MOST_CROPPED_SHARE = 0.5


@dataclass(frozen=True)
class StageCost:
    """A row of the table."""

    of: str = ""
    cpu_s: str = ""
    memory_mb: str = ""
    thread_memory_mb: str = ""
    disk_mb: str = ""
    max_threads: int = 1


def weigh(formula: str, quantities: Mapping[str, float]) -> float:
    """Return the value of a formula of the table."""
    total = 0.0
    for term in filter(None, formula.split(" + ")):
        *factor, last = term.split()
        value = quantities[last] if last.isidentifier() else float(last)
        total += value * (float(factor[0]) if factor else 1.0)
    return total


def stages_of(*kinds: str, stereo: str = "cpu") -> dict[str, StageCost]:
    """Return the stages of scans of some kinds, the stereo's with a backend."""
    backend = BACKENDS[stereo]
    own = replace(
        STAGES["estimate_depth"],
        cpu_s=backend.cpu_s,
        memory_mb=backend.memory_mb,
        max_threads=backend.max_threads,
    )
    stages = {**STAGES, "estimate_depth": own}
    return {rule: stage for rule, stage in stages.items() if stage.of in kinds}


STAGES = {
    rule: StageCost(**cells)
    for rule, cells in load_schema(Path(__file__).with_name("stage_costs.yaml")).items()
}
