"""Photos of a fruit tree in; a metric labelled cloud, skeleton, topology graph and traits out."""

# Before anything may load pycolmap: its wheel exports parts of a zlib of its own, and Python's zlib
# loaded after it mixes the two and corrupts the heap (zlib.compressobj, savez, numba's cache).
import zlib  # noqa: F401

__version__ = "0.2.0"
