"""How far what each photo shows is: a small PNG a photo, kept when the stereo's maps are gone.

A pixel holds ``32768 + 2048 log2(depth)`` as 16 bits, 0 where no depth is known: within 0.017 % of
the depth, a sixtieth of what tells two things in a photo apart (`evidence.witnesses`).
"""

from pathlib import Path

import cv2
import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path

STEPS, ONE = 2048, 32768


def write_depth_raster(folder: Path, name: str, depth: np.ndarray) -> None:
    """Write the depths of a photo, (height, width) float, 0 where unknown, as ``{stem}.png``."""
    known = depth > 0
    steps = np.rint(ONE + STEPS * np.log2(np.where(known, depth, 1.0)))
    raster = np.where(known, np.clip(steps, 1, 2**16 - 1), 0).astype(np.uint16)
    with atomic_path(_path(folder, name)) as temporary:
        if not cv2.imwrite(str(temporary), raster):
            raise StageError("the depths of a photo cannot be written", file=_path(folder, name))


def read_depth_raster(folder: Path, name: str) -> np.ndarray | None:
    """Read the depths of a photo, (height, width) float32, 0 where unknown; None without a file.

    Raises
    ------
    StageError
        If the file is none of these.
    """
    path = _path(folder, name)
    if not path.is_file():
        return None
    raster = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if raster is None or raster.dtype != np.uint16 or raster.ndim != 2:
        raise StageError("the depths of a photo are unreadable", file=path)
    steps = (raster.astype(np.float32) - ONE) / STEPS
    return np.where(raster > 0, np.exp2(steps), np.float32(0))


def _path(folder: Path, name: str) -> Path:
    return Path(folder) / f"{Path(name).stem}.png"
