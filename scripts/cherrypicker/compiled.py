"""Numba with a cache that is never stale, that works in a read-only installation, and that tells.

Numba's own cache is invalidated by the file that holds a function, not by the modules of the
functions it calls, and lies beside the source, which a shared installation may not allow. Here the
cache folder carries a digest of all compiled functions of the package, in the first writable place.
Compiling takes tens of seconds, once for a version of the package on a machine: the first function
that has to be compiled says so, and other processes wait for it and load it.
"""

from __future__ import annotations

import fcntl
import hashlib
import logging
import os
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

import numba
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

logger = logging.getLogger(__name__)

PACKAGE = Path(__file__).parent


def cache_folder() -> str:
    """Return the folder of the compiled functions of this very version of the package.

    The first writable one of ``$NUMBA_CACHE_DIR``, ``$XDG_CACHE_HOME`` (or ``~/.cache``) and the
    system's temporary folder.
    """
    digest = hashlib.sha256()
    for source in sorted(PACKAGE.rglob("*.py")):
        content = source.read_bytes()
        if b"cherrypicker.compiled" in content or source == Path(__file__):
            digest.update(content)
    name = Path("cherrypicker") / digest.hexdigest()[:16]
    user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    private = f"cherrypicker-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    places = [os.environ.get("NUMBA_CACHE_DIR"), user, os.path.join(tempfile.gettempdir(), private)]
    for place in places:
        if not place:
            continue
        folder = Path(place) / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return tempfile.mkdtemp(prefix="cherrypicker-")


# Numba's own modules were decorated before this line, those of this package after it
numba.config.CACHE_DIR = cache_folder()  # type: ignore[attr-defined]


class _Teller(event.Listener):
    """Says once a process that a function of ours is not in the cache and is being compiled."""

    has_told = False

    def on_start(self, event: event.Event) -> None:
        module = event.data["dispatcher"].py_func.__module__
        if not self.has_told and module.startswith("cherrypicker"):
            self.has_told = True
            logger.warning(
                "compiling for this machine, once, which takes up to a minute; it is kept in %s",
                numba.config.CACHE_DIR,  # type: ignore[attr-defined]
            )

    def on_end(self, event: event.Event) -> None:
        """One function has been compiled; others may follow."""


event.register("numba:compile", _Teller())

_held: list[int] = []  # descriptors of the cache's lock: one, while this process compiles


def _in_turn(dispatcher: Any) -> Any:
    """Let one process compile a function, and others wait and load it from the cache.

    A file system that cannot lock is no reason not to go on.
    """
    compile_now = dispatcher.compile

    def compile_in_turn(signature: Any) -> Any:
        with global_compiler_lock:
            if _held:  # a function that the one being compiled calls
                return compile_now(signature)
            with suppress(OSError):
                path = Path(numba.config.CACHE_DIR, ".lock")  # type: ignore[attr-defined]
                _held.append(os.open(path, os.O_CREAT | os.O_RDWR, 0o644))
                fcntl.flock(_held[0], fcntl.LOCK_EX)
            try:
                return compile_now(signature)
            finally:
                while _held:
                    os.close(_held.pop())

    dispatcher.compile = compile_in_turn
    return dispatcher


# A number in a kernel: numba knows which
Num: TypeAlias = Any

OPTIONS: dict[str, Any] = {
    "fastmath": True,
    "nogil": True,
    "cache": True,
    "error_model": "numpy",
    "_nrt": False,
}


def compiled(function: Callable[..., Any]) -> Any:
    """Compile any function that is no kernel of the photos."""
    return _in_turn(numba.njit(function, nogil=True, cache=True))


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for float32 arrays; it must not allocate memory.

    No reference counts, which would cost more than the arithmetic when a tuple of arrays is handed
    on for every pixel, and no test for a zero divisor, which would keep loops from vectorising.
    """
    return _in_turn(numba.njit(function, **OPTIONS))


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function that kernels call, into the body of each.

    Were it a function of its own, each kernel would carry a copy, optimised in its own way, and
    which copy runs would depend on the order in which they are loaded: the last digits of a depth
    map would differ between the process that compiles and those that load from the cache.
    """
    return _in_turn(numba.njit(function, forceinline=True, **OPTIONS))


def in_parallel(work: Callable[[int], None], items: Iterable[int], threads: int) -> None:
    """Call ``work`` for every item on some threads; kernels release the interpreter's lock.

    Plain threads over blocks of rows compile in a third of the time of numba's parallel loops and
    do not spin where other jobs want the processor.
    """
    if threads <= 1:
        for item in items:
            work(item)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(work, items):
            pass
