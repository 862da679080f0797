"""From the pixels of one photo into another: the matrices, and what kernels do with them."""

import numpy as np

from cherrypicker.compiled import Num, inlined

# What projects nearer lies behind a photo, in depths of the photo that it comes from
BEHIND = np.float32(1e-6)


def relative_projection(reference: tuple, source: tuple) -> np.ndarray:
    """Return A by rows and b, (12,) float64, from (K, R, t) of reference and source."""
    K_r, R_r, t_r = reference
    K_s, R_s, t_s = source
    R = R_s @ R_r.T
    A = K_s @ R @ np.linalg.inv(K_r)
    b = K_s @ (t_s - R @ t_r)
    return np.r_[A.ravel(), b]


@inlined
def depth_in(P: np.ndarray, s: Num, x: Num, y: Num, w: Num) -> Num:
    """Return the depth in photo ``s`` of pixel (x, y) at inverse depth ``w``, times ``w``.

    ``P`` (n, 12) holds a `relative_projection` a photo. A depth of `BEHIND` or less is none.
    """
    return P[s, 6] * x + P[s, 7] * y + P[s, 8] + P[s, 11] * w


@inlined
def pixel_in(P: np.ndarray, s: Num, x: Num, y: Num, w: Num, z: Num) -> tuple[Num, Num]:
    """Return where that pixel lies in photo ``s``, u and v, given its `depth_in`."""
    u = (P[s, 0] * x + P[s, 1] * y + P[s, 2] + P[s, 9] * w) / z
    v = (P[s, 3] * x + P[s, 4] * y + P[s, 5] + P[s, 10] * w) / z
    return u, v


@inlined
def pixel_at(u: Num) -> Num:
    """Return the row or column whose pixel a place along it lies in; centres are whole numbers."""
    return np.int64(np.floor(u + np.float32(0.5)))


@inlined
def cross_ball(x: Num, y: Num, z: Num, ball: np.ndarray) -> tuple[Num, Num]:
    """Where a ray (x, y, z) passes the middle of a ball, and the squared reach of the ball there.

    Both in lengths of the ray, from its start; ``ball`` holds the centre from there and the radius.
    The square is negative where the ray misses the ball.
    """
    square = x * x + y * y + z * z
    along = (x * ball[0] + y * ball[1] + z * ball[2]) / square
    rest = ball[0] ** 2 + ball[1] ** 2 + ball[2] ** 2 - ball[3] ** 2
    return along, along * along - rest / square
