"""Random numbers that depend on nothing but a seed and a count: no state, any order of pixels."""

import numpy as np

from cherrypicker.compiled import Num, inlined

# Pixels take so many numbers each at most
DRAWS_A_PIXEL = np.uint64(4096)


@inlined
def uniform(seed: Num, draw: Num) -> Num:
    """Return a float32 in [0, 1) that depends on seed and draw only."""
    z = (seed + np.uint64(draw)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = (z ^ (z >> np.uint64(31))) >> np.uint64(40)
    return np.float32(z) * np.float32(1.0 / 16777216.0)
