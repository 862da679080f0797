"""Let a batch resume after a power cut, and keep two runs in one folder out of each other's way.

Snakemake locks its folder, and a killed run cannot unlock it; nor does it look for a lock and take
it in one step. So each run holds two locks of the system, which die with its process: `starting`
alone, until Snakemake has its own, and `running` together with other runs. Who can have `running`
alone knows that nobody else runs, and unlocks the folder as `snakemake --unlock` does.
"""

import fcntl
import logging
import os
import socket
from pathlib import Path

logger = logging.getLogger(__name__)

FOLDER = Path(".snakemake")

_starting: list[int] = []
_running: list[int] = []  # until the end of the process


def begin_start() -> None:
    """Wait until no other run is starting in this folder; the next one then waits for this one.

    A file system that cannot lock is no reason not to go on: Snakemake's own lock is still to come.
    """
    end_start()  # of a workflow that this process loaded before
    try:
        FOLDER.mkdir(exist_ok=True)
        starting, running = (
            os.open(FOLDER / name, os.O_RDWR | os.O_CREAT, 0o644)
            for name in ("starting", "running")
        )
        _starting.append(starting)
        _running.append(running)
        if not _take(starting):
            logger.warning("another run is starting in this folder; waiting for it")
            fcntl.flock(starting, fcntl.LOCK_EX)
        if _take(running):
            _unlock_if_ours(running)
        fcntl.flock(running, fcntl.LOCK_SH)
    except OSError as error:  # a folder that takes no file, a file system without locks
        logger.warning("cannot look for other runs in this folder: %s", error)


def end_start() -> None:
    """Let the next run start: this one holds Snakemake's own lock by now."""
    while _starting:
        os.close(_starting.pop())


def _take(descriptor: int) -> bool:
    """Lock a file for this process alone, if no other has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _unlock_if_ours(running: int) -> None:
    """Release what a killed run left, unless on another machine, whose locks may not reach here."""
    note, here = FOLDER / "running", socket.gethostname()
    is_locked = any((FOLDER / "locks").glob("*"))
    if is_locked and note.read_text(encoding="utf-8") != here:
        return
    os.truncate(running, 0)
    os.pwrite(running, here.encode(), 0)
    if is_locked:
        from snakemake.persistence.file import FilePersistence

        FilePersistence().cleanup_locks()
        logger.warning("released the lock of a run that was killed")
