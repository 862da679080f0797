"""The backends that the benchmark of dense stereo compares: the product's, and the naive floor."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cherrypicker.mvs.backends.table import BACKENDS, Backend, has_cuda


def _sgbm(*work: Any) -> set[str]:
    from cherrypicker_lab.dense.sgbm import run_sgbm

    return run_sgbm(*work)


# Photos of 1.2 megapixels, docs/lab/dense.md
_SGBM = Backend("SGBM (OpenCV)", _sgbm, {"base": 2.0, "stereo_mp": 3.5}, {"base": 430.0})
ALL_BACKENDS = {
    "cpu": BACKENDS["cpu"],
    "sgbm": _SGBM,
    "sgbm_sky": replace(_SGBM, title="SGBM, our sky masks"),
    **{name: backend for name, backend in BACKENDS.items() if name != "cpu"},
}
# SGBM runs as it comes, and once more with the masks that our own backend is given
WITH_SKY_MASKS = ("cpu", "sgbm_sky")


def backends_here() -> list[str]:
    """Return the backends that can run with the installed pycolmap."""
    return [name for name, one in ALL_BACKENDS.items() if has_cuda() or not one.needs_cuda]
