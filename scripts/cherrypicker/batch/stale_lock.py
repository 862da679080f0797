"""Let a batch resume after a power cut, and keep two runs in one folder out of each other's way.

Snakemake locks its working directory, and a killed run cannot unlock it. Its lock files do not say
whose they are, so each run notes its process beside them. Nor does it look for a lock and take it
in one step: two runs that start together both find the folder free. So runs start one after the
other, under a lock of the system that dies with its process.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import socket
import time
from pathlib import Path

import psutil

logger = logging.getLogger(__name__)

OWNER_FILE = Path(".snakemake/lock_owner.json")
LOCK_DIR = Path(".snakemake/locks")
START_FILE = Path(".snakemake/starting")

_POLL_S = 0.1
_held: list[int] = []


def begin_start(patience_s: float = 120.0) -> bool:
    """Wait until no other run is starting in this folder; the next one then waits for this one.

    A file system that cannot lock, or a run that takes longer than that to start, is no reason not
    to go on: Snakemake's own lock is still to come.

    Parameters
    ----------
    patience_s : float, default 120
        Longest wait, seconds.

    Returns
    -------
    bool
        Whether other runs now wait for :func:`end_start`, or for the end of this process.
    """
    try:
        START_FILE.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(START_FILE, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        logger.warning("cannot look for other runs that start here: %s", error)
        return False
    deadline = time.monotonic() + patience_s
    is_told = False
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                logger.warning("another run has been starting in this folder for long; going on")
                break
            if not is_told:
                logger.warning("another run is starting in this folder; waiting for it")
                is_told = True
            time.sleep(_POLL_S)
        except OSError:  # a file system without locks
            break
        else:
            _held.append(descriptor)
            return True
    os.close(descriptor)
    return False


def end_start() -> None:
    """Let the next run start: this one holds Snakemake's own lock by now."""
    while _held:
        descriptor = _held.pop()
        fcntl.flock(descriptor, fcntl.LOCK_UN)
        os.close(descriptor)


def claim_lock() -> bool:
    """Note this process as the owner of the lock, releasing one that a dead process left.

    A lock whose owner is alive, unknown, or on another machine is left alone: Snakemake then
    refuses to start, as it should.

    Returns
    -------
    bool
        Whether a stale lock was released.
    """
    owner = _read_owner()
    is_locked = LOCK_DIR.is_dir() and any(LOCK_DIR.iterdir())
    if is_locked:
        if owner is None or not _is_gone(owner):
            return False
        for path in LOCK_DIR.iterdir():
            path.unlink(missing_ok=True)
        logger.warning("released the lock of a run that was killed (process %d)", owner["pid"])
    _write_owner()
    return is_locked


def _read_owner() -> dict | None:
    try:
        owner = json.loads(OWNER_FILE.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return owner if isinstance(owner, dict) and {"pid", "started", "host"} <= set(owner) else None


def _write_owner() -> None:
    process = psutil.Process(os.getpid())
    owner = {"pid": process.pid, "started": process.create_time(), "host": socket.gethostname()}
    try:
        OWNER_FILE.parent.mkdir(parents=True, exist_ok=True)
        OWNER_FILE.write_text(json.dumps(owner), encoding="utf-8")
    except OSError as error:
        logger.warning("cannot note who holds the lock: %s", error)


def _is_gone(owner: dict) -> bool:
    """Whether the owner ran on this machine and its process, not just its number, is dead."""
    if owner["host"] != socket.gethostname():
        return False
    try:
        return abs(psutil.Process(owner["pid"]).create_time() - owner["started"]) > 1.0
    except psutil.NoSuchProcess:
        return True
    except psutil.Error:
        return False
