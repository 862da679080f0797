"""How long a run still takes: the forecast of its stages, at the pace that it has kept so far."""

import time
from collections import Counter
from collections.abc import Mapping
from statistics import mean

from cherrypicker.batch.batch import Batch
from cherrypicker.batch.forecast import forecast_jobs, read_corrections
from cherrypicker.batch.resources import STAGES
from cherrypicker.batch.scans import Scans

# Rules of another name that do the work of a stage of the forecast
_SAME = {"import_segmented_cloud": "import_cloud", "solve_graph": "extract_graph"}
# The pace counts from this share of the work on, or a first short stage would tell it (guess)
_ENOUGH_DONE = 0.05


def seconds_of_stages(batch: Batch) -> dict[str, float]:
    """Return the CPU seconds of a job of each stage, the mean over the batch's trees."""
    scans = Scans(batch).sizes()
    jobs = forecast_jobs(scans, read_corrections(scans))
    found = {rule: [job.cpu_s for job in jobs if job.rule == rule] for rule in STAGES}
    return {rule: mean(seconds) for rule, seconds in found.items() if seconds}


class TimeLeft:
    """The work of a run by the CPU seconds of a job of each rule, and how much of it is done."""

    def __init__(self, seconds: Mapping[str, float]) -> None:
        self._seconds = seconds
        # Of a rule that the forecast has not, which works little: as of the least stage
        self._least_s = min(seconds.values(), default=1.0)
        self.waiting: Counter[str] = Counter()
        self.cores = 1
        self._done_s = 0.0
        self._start = time.monotonic()

    def finish(self, rule: str) -> None:
        """Count a job of a rule as done."""
        if self.waiting[rule] > 0:
            self.waiting[rule] -= 1
            self._done_s += self._of(rule)

    def fail(self, rule: str) -> None:
        """Leave out a stage and those of its tree that would have followed."""
        stages = list(self._seconds)
        rule = _SAME.get(rule, rule)
        for each in stages[stages.index(rule) :] if rule in stages else ():
            self.waiting[each] = max(self.waiting[each] - 1, 0)

    def left_s(self) -> float:
        """Return the seconds from now to the end."""
        waiting_s = sum(count * self._of(rule) for rule, count in self.waiting.items())
        pace = 1.0 / self.cores  # seconds on the clock a second of forecast work
        if self._done_s > _ENOUGH_DONE * (self._done_s + waiting_s):
            pace = (time.monotonic() - self._start) / self._done_s
        return pace * waiting_s

    def _of(self, rule: str) -> float:
        return 0.0 if rule == "all" else self._seconds.get(_SAME.get(rule, rule), self._least_s)
