"""Meshes of things: closed, of the size asked for, their faces turned outwards."""

import numpy as np
import pytest

from cherrypicker_lab.orchard.scene.shapes import bar, blades, plate, sheet, tube, turned


def _volume(mesh):
    """Of a closed mesh, m3, positive where its faces look outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (plate(0.4, 0.2, 0.01), 0.4 * 0.2 * 0.01),
        (plate(0.4, 0.2, 0.01, corners=3), 0.4 * 0.2 * 0.01 / 2),
        (plate(0.4, 0.2, 0.01, corners=48), np.pi * 0.2 * 0.1 * 0.01),
        (turned([0, 0.1, 0.1, 0], [0, 0, 0.5, 0.5], 64), np.pi * 0.1**2 * 0.5),
        (turned([0, 0.1, 0], [0, 0, 0.3], 64), np.pi * 0.1**2 * 0.3 / 3),
        (bar([0, 0, 0], [0.3, 0.4, 0.0], 0.05, 0.02), 0.5 * 0.05 * 0.02),
        (bar([0.1, 0.1, 0], [0.1, 0.1, 2.0], 0.05, sides=48), np.pi * 0.025**2 * 2.0),
    ],
)
def test_solids_hold_their_volume(mesh, volume):
    assert _volume(mesh) == pytest.approx(volume, rel=0.01)


def test_a_tube_keeps_its_radius_along_a_bent_line():
    t = np.linspace(0, 2, 60)
    line = np.column_stack([t, np.sin(t), 0.2 * t])
    made = tube(line, 0.03, sides=12)
    apart = np.linalg.norm(made.vertices.reshape(60, 12, 3) - line[:, None], axis=2)
    assert apart == pytest.approx(0.03)
    normals = made.vertex_normals().reshape(60, 12, 3)[5:-5]
    outward = (made.vertices.reshape(60, 12, 3) - line[:, None])[5:-5] / 0.03
    assert (np.einsum("ijk,ijk->ij", normals, outward) > 0.9).all()


def test_a_sheet_and_blades_are_seen_from_both_sides():
    roof = sheet(2.0, 1.0, lambda u, v: 2.5 + 0.5 * v)
    feet, ways = np.zeros((5, 3)), np.tile([0.0, 0.0, 0.2], (5, 1))
    for mesh, area in ((roof, 2 * 2.0 * np.hypot(1.0, 0.5)), (blades(feet, ways, 0.01), 0.01)):
        assert mesh.face_areas().sum() == pytest.approx(area)
        a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
        assert np.cross(b - a, c - a).sum(axis=0) == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(roof.vertices, axis=0) == pytest.approx([2.0, 1.0, 0.5])
