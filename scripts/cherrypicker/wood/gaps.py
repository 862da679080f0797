"""How far wood may be missing and yet be one tree's: the lengths that every stage starts from.

Both are guesses. The config's ``contract.gap_m`` and ``contract.stem_gap_m`` default to them.
"""

__all__ = ["GAP_M", "STEM_GAP_M"]

GAP_M = 0.25
"""Longest gap along a branch, or between pieces of trunk (a calibration ring), metres."""

STEM_GAP_M = 0.6
"""Longest gap along a stem, between its foot and its crown, metres."""
