"""Numba with a cache that is never stale and that works in a read-only installation.

Numba's own cache is invalidated by the file that holds a function, not by the modules of the
functions it calls, and lies beside the source, which a shared installation may not allow. Here the
cache folder carries a digest of all kernels of this package, in the first writable place.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

# Threads that wait for the slowest must not burn the time of other jobs
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numba
from numba import prange

__all__ = ["kernel", "parallel_kernel", "prange", "use_threads"]


def cache_folder() -> str:
    """Return the folder of the compiled kernels of this very version of the package.

    The first writable one of ``$NUMBA_CACHE_DIR``, ``$XDG_CACHE_HOME`` (or ``~/.cache``) and the
    system's temporary folder.
    """
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        content = source.read_bytes()
        if b"kernel" in content:
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
numba.config.CACHE_DIR = cache_folder()


# error_model="numpy" saves the test for a zero divisor, which would keep loops from vectorising
def kernel(function):
    """Compile an inner function: it allocates nothing.

    Without the runtime's reference counts, which would cost more than the arithmetic when a tuple
    of arrays is handed on for every pixel.
    """
    return numba.njit(
        function, fastmath=True, nogil=True, cache=True, error_model="numpy", _nrt=False
    )


def parallel_kernel(function):
    """Compile a function whose ``prange`` loops run on all threads of :func:`use_threads`."""
    return numba.njit(
        function, fastmath=True, nogil=True, cache=True, error_model="numpy", parallel=True
    )


def use_threads(threads: int) -> int:
    """Set the number of threads of the parallel kernels and return what was set."""
    threads = max(1, min(int(threads), numba.config.NUMBA_NUM_THREADS))
    numba.set_num_threads(threads)
    return threads
