"""Sides of a tree beyond which few photos look."""

import numpy as np
import pytest
from scan_scene import level_ring, look_at_poses
from sound_tree import flags_of

from cherrypicker.evidence.frame_edges import frame_edges
from cherrypicker.traits.reports import Reports

N_PHOTOS, DISTANCE, FOCAL = 12, 4.0, 1000.0


def ring(width=1000, height=2000, azimuths=None):
    """Level photos from a ring at height 1, all aimed at the axis x = y = 0."""
    centers = level_ring(N_PHOTOS, DISTANCE)
    if azimuths is not None:
        cos, sin = np.cos(azimuths), np.sin(azimuths)
        centers = np.column_stack([DISTANCE * cos, DISTANCE * sin, np.ones(len(azimuths))])
    return look_at_poses(centers, [0, 0, 1.0], size=(width, height), focal=FOCAL)


def column(top, half_width=0.3):
    rng = np.random.default_rng(0)
    low, high = (-half_width, -half_width, 0.0), (half_width, half_width, top)
    return rng.uniform(low, high, (4000, 3))


def test_frame_around_tree():
    assert frame_edges(ring(), column(top=2.5)) == []


def test_top_outside():
    # the frame ends 1 m above the camera's height at half the distance of 4 m: 2 m at the axis
    cut = ring(height=500)
    (edge,) = frame_edges(cut, column(top=1.98))
    assert edge.azimuth_deg is None
    assert edge.beyond == pytest.approx(0.05 * 1.98, rel=0.01)
    assert (edge.n_photos, edge.n_usual) == (0, N_PHOTOS)
    (flag,) = flags_of(Reports(), edges=[edge])
    assert flag.startswith("top_outside_photos: 0 photos frame what is 0.10 m above")


def test_sides_outside():
    # photos from two opposite sides, whose frames end 0.28 m (at the axis) to the left and right
    cut = ring(width=140, azimuths=np.repeat([0.0, np.pi], 6))
    edges = frame_edges(cut, column(top=1.5, half_width=0.28))
    assert {edge.azimuth_deg for edge in edges} >= {90.0, 270.0}
    assert not {0.0, 180.0, None} & {edge.azimuth_deg for edge in edges}
    (flag,) = flags_of(Reports(), edges=edges)
    assert flag.startswith("side_outside_photos: towards azimuth")


def test_few_points():
    assert frame_edges(ring(), column(top=1.0)[:1]) == []
