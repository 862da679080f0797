"""The median for compiled code (a small function that compiles fast).

NumPy's own, called in a compiled function, is compiled anew into every function that calls it and
takes seconds on the first run of a machine.
"""

from __future__ import annotations

import numpy as np

from cherrypicker.compiled import compiled

__all__ = ["median"]


@compiled
def median(values: np.ndarray) -> float:
    """Median of values (one at least), NaN if one of them is; puts them in another order."""
    n = len(values)
    for row in range(n):
        if np.isnan(values[row]):
            return np.nan
    middle, low, high = n // 2, 0, n - 1
    while low < high:  # Hoare's selection
        pivot, left, right = values[(low + high) // 2], low, high
        while left <= right:
            while values[left] < pivot:
                left += 1
            while values[right] > pivot:
                right -= 1
            if left <= right:
                values[left], values[right] = values[right], values[left]
                left += 1
                right -= 1
        if middle <= right:
            high = right
        elif middle >= left:
            low = left
        else:
            break
    if n % 2:
        return values[middle]
    below = values[0]
    for row in range(1, middle):
        below = max(below, values[row])
    return 0.5 * (below + values[middle])
