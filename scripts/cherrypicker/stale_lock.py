"""Let a batch resume after a power cut: release the folder's lock when its owner is gone.

Snakemake locks its working directory, and a killed run cannot unlock it. Its lock files do not say
whose they are, so each run notes its process beside them.
"""

from __future__ import annotations

import json
import logging
import os
import socket
from pathlib import Path

import psutil

logger = logging.getLogger(__name__)

OWNER_FILE = Path(".snakemake/lock_owner.json")
LOCK_DIR = Path(".snakemake/locks")


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
    if is_locked and (owner is None or not _is_gone(owner)):
        return False
    if is_locked:
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
