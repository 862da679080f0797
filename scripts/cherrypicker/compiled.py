"""Numba with a cache that is never stale, that works in a read-only installation, and that tells.

Numba's own cache is invalidated by the file that holds a function, not by those that hold what the
function calls and reads, and lies beside the source, which a shared installation may not allow.
Here the functions of a module lie under a digest of all these files, in the first writable place:
installations share them, and a new version compiles only what has changed.
Compiling takes tens of seconds, once for a version of the package on a machine: the first function
that has to be compiled says so, and other processes wait for it and load it.
"""

import fcntl
import hashlib
import logging
import os
import re
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numba
from numba.core import event
from numba.core.caching import UserProvidedCacheLocator
from numba.core.compiler_lock import global_compiler_lock

from cherrypicker.files import imports_of

logger = logging.getLogger(__name__)

ROOT = Path(__file__).parent.parent
_COMPILES = re.compile(r"cherrypicker\.compiled|(?:from|import) numba")


def cache_folder() -> str:
    """Return the folder of the compiled functions.

    The first writable one of ``$NUMBA_CACHE_DIR``, ``$XDG_CACHE_HOME`` (or ``~/.cache``) and the
    system's temporary folder.
    """
    user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    private = f"cherrypicker-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    places = [os.environ.get("NUMBA_CACHE_DIR"), user, os.path.join(tempfile.gettempdir(), private)]
    for place in places:
        if not place:
            continue
        folder = Path(place) / "cherrypicker"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return tempfile.mkdtemp(prefix="cherrypicker-")


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def digest_of_compiled(module: Path) -> str:
    """Return a digest of a module's file and of all whose functions or constants it compiles in."""
    found: set[Path] = set()
    waiting = [module, Path(__file__)]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            for other, names in imports_of(path, ROOT).items():
                if any(map(str.isupper, names)) or _COMPILES.search(_text(other)):
                    waiting.append(other)
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(found):
        digest.update(_text(path).encode())
    return digest.hexdigest()[:16]


class ByDigest(UserProvidedCacheLocator):
    """Where what is compiled of a module of ours lies, wherever the module itself does."""

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        """Return none for a module of others."""
        is_ours = Path(py_file).is_relative_to(ROOT) and py_func.__module__.startswith(__package__)
        return super().from_function(py_func, py_file) if is_ours else None

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Return the name of the module's folder."""
        path = Path(py_file)
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts[1:])
        return f"{name}-{digest_of_compiled(path)}"


_config: Any = numba.config
# Numba's own modules were decorated before these lines, those of this package after them
_config.CACHE_DIR = cache_folder()
_others = _config.CACHE_LOCATOR_CLASSES or UserProvidedCacheLocator.__name__
_config.CACHE_LOCATOR_CLASSES = f"{__name__}.{ByDigest.__name__},{_others}"


class _Teller(event.Listener):
    """Says once a process that a function of ours is not in the cache and is being compiled."""

    has_told = False

    def on_start(self, event: event.Event) -> None:
        module = event.data["dispatcher"].py_func.__module__
        if not self.has_told and module.startswith("cherrypicker"):
            self.has_told = True
            logger.warning(
                "compiling for this machine, once, which takes up to a minute; it is kept in %s",
                _config.CACHE_DIR,
            )

    def on_end(self, event: event.Event) -> None:
        """One function has been compiled; others may follow."""


event.register("numba:compile", _Teller())

_held: list[int] = []  # descriptors of a module's lock: one, while this process compiles


def _in_turn(dispatcher: Any) -> Any:
    """Let one process compile a module's function, and others wait and load it from the cache.

    A file system that cannot lock is no reason not to go on.
    """
    compile_now = dispatcher.compile

    def compile_in_turn(signature: Any) -> Any:
        with global_compiler_lock:
            if _held:  # a function that the one being compiled calls
                return compile_now(signature)
            with suppress(OSError):
                path = Path(dispatcher.stats.cache_path, ".lock")
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
