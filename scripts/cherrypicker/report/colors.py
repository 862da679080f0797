"""Colours that the classes are drawn in, one for each `Label`."""

from __future__ import annotations

from cherrypicker.classes import Label

CLASS_COLORS: dict[int, tuple[float, float, float]] = {
    Label.GROUND: (0.62, 0.55, 0.42),
    Label.TRUNK: (0.45, 0.24, 0.10),
    Label.BRANCH: (0.18, 0.55, 0.24),
    Label.SIGN: (0.95, 0.77, 0.06),
    Label.MARKER: (0.84, 0.15, 0.16),
    Label.CALIBRATION_UNIT: (0.12, 0.47, 0.71),
    Label.ROOF: (0.55, 0.34, 0.76),
    Label.SUPPORT_POST: (0.50, 0.50, 0.50),
    Label.UNLABELLED: (0.80, 0.80, 0.80),
}
