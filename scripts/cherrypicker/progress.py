"""Progress of long loops, with the time left, on the console and in the log."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

logger = logging.getLogger(__name__)

T = TypeVar("T")
R = TypeVar("R")


class Progress:
    """Report about every ten percent of a loop of `total` steps, 5 seconds apart at least.

    ``what`` is being counted, "depth maps" for instance.
    """

    def __init__(self, total: int, what: str):
        self.total = max(int(total), 1)
        self.what = what
        self.done = 0
        self._lock = threading.Lock()
        self._start = self._last_time = time.monotonic()
        self._last_tenth = 0

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *exception: object) -> None:
        if exception[0] is None:
            took = time.monotonic() - self._start
            logger.info("%s: %d done in %s", self.what, self.done, duration(took))

    def step(self, n: int = 1) -> None:
        """Count ``n`` further steps as done."""
        with self._lock:
            self.done += n
            now = time.monotonic()
            tenth = 10 * self.done // self.total
            is_early = tenth == self._last_tenth or now - self._last_time < 5.0
            if is_early or self.done >= self.total:
                return
            self._last_tenth, self._last_time = tenth, now
            left = (now - self._start) / self.done * (self.total - self.done)
        logger.info(
            "%s: %d of %d (%d %%), %s left",
            *(self.what, self.done, self.total, 100 * self.done // self.total, duration(left)),
            extra={"console": True},
        )


def in_threads(
    work: Callable[[T], R], items: Collection[T], threads: int, what: str
) -> Iterator[R]:
    """Yield what ``work`` makes of each item, in their order, and report progress."""
    with ThreadPoolExecutor(threads) as pool, Progress(len(items), what) as bar:
        for result in pool.map(work, items):
            yield result
            bar.step()


def duration(seconds: float) -> str:
    """Return a span of time as people say it."""
    if (days := seconds / 86400.0) > 1.0:
        return f"{days:.1f} days"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
