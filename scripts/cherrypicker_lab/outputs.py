"""Figures to files."""

from __future__ import annotations

import os

from matplotlib.figure import Figure

from cherrypicker.files import atomic_path


def save(figure: Figure, path: str | os.PathLike) -> None:
    """Write a figure as PNG, atomically and without a date."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=100, format="png", metadata={"Software": None})
