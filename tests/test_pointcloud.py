import numpy as np
import pytest

from cherrypicker.errors import StageError
from cherrypicker.ply import read_ply_vertices, vertex_properties
from cherrypicker.pointcloud import PointCloud, read_cloud, write_cloud


@pytest.fixture
def cloud():
    rng = np.random.default_rng(0)
    return PointCloud(
        rng.normal(size=(50, 3)).astype(np.float32),
        colors=rng.integers(0, 256, (50, 3)) / 255.0,
        normals=rng.normal(size=(50, 3)),
        fields={
            "label": rng.integers(0, 8, 50).astype(np.uint8),
            "confidence": rng.random(50, dtype=np.float32),
            "source": np.arange(50, dtype=np.int32),
        },
        frame="metric",
        unit="arbitrary",
    )


def test_round_trip_keeps_everything(cloud, tmp_path):
    write_cloud(tmp_path / "a.ply", cloud)
    back = read_cloud(tmp_path / "a.ply", required=("label", "colors", "normals"))
    np.testing.assert_array_equal(back.points, cloud.points)
    np.testing.assert_allclose(back.colors, cloud.colors, atol=1e-6)
    np.testing.assert_array_equal(back.normals, cloud.normals)
    for name in cloud.fields:
        np.testing.assert_array_equal(back[name], cloud[name])
        assert back[name].dtype == cloud[name].dtype
    assert (back.frame, back.unit) == ("metric", "arbitrary")


def test_equal_clouds_give_equal_bytes(cloud, tmp_path):
    write_cloud(tmp_path / "a.ply", cloud)
    write_cloud(tmp_path / "b.ply", read_cloud(tmp_path / "a.ply"))
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_geographic_coordinates_are_written_as_double(tmp_path):
    points = np.array([[652_345.1234, 5_512_345.4321, 311.1111], [652_345.13, 5_512_345.44, 311.2]])
    write_cloud(tmp_path / "utm.ply", PointCloud(points))
    np.testing.assert_allclose(read_cloud(tmp_path / "utm.ply").points, points, atol=1e-9)


def test_open3d_reads_what_we_write(cloud, tmp_path):
    o3d = pytest.importorskip("open3d")
    write_cloud(tmp_path / "a.ply", cloud)
    seen = o3d.io.read_point_cloud(str(tmp_path / "a.ply"))
    np.testing.assert_allclose(np.asarray(seen.points), cloud.points, atol=1e-6)
    np.testing.assert_allclose(np.asarray(seen.colors), cloud.colors, atol=1 / 255)


def test_ascii_with_crlf_is_read(tmp_path):
    text = "ply\r\nformat ascii 1.0\r\nelement vertex 2\r\nproperty double x\r\n"
    text += "property double y\r\nproperty double z\r\nend_header\r\n1 2 3\r\n4 5 6\r\n"
    (tmp_path / "a.ply").write_bytes(text.encode())
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.ply").points, [[1, 2, 3], [4, 5, 6]])


def _truncated(cloud, path):
    write_cloud(path, cloud)
    path.write_bytes(path.read_bytes()[:-20])


def _not_finite(cloud, path):
    cloud.points[3, 1] = np.nan
    write_cloud(path, cloud)


def _no_ply(cloud, path):
    path.write_text("solid nonsense")


def _nothing(cloud, path):
    pass


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (_truncated, "promises 50 vertices"),
        (_not_finite, "1 of 50 points are not finite"),
        (_no_ply, "not a PLY"),
        (_nothing, "missing"),
    ],
)
def test_bad_files_are_refused_by_name(cloud, tmp_path, spoil, reason):
    path = tmp_path / "bad.ply"
    spoil(cloud, path)
    with pytest.raises(StageError, match=reason) as error:
        read_cloud(path)
    assert str(path) in str(error.value)


def test_a_missing_field_is_named(cloud, tmp_path):
    write_cloud(tmp_path / "a.ply", PointCloud(cloud.points))
    with pytest.raises(StageError, match="no label"):
        read_cloud(tmp_path / "a.ply", required=("label",))


def test_an_empty_cloud_is_never_written(cloud, tmp_path):
    with pytest.raises(StageError, match="empty"):
        write_cloud(tmp_path / "a.ply", cloud.select(np.zeros(50, dtype=bool)))
    assert list(tmp_path.iterdir()) == []


def test_the_header_alone_tells_the_properties(cloud, tmp_path):
    write_cloud(tmp_path / "a.ply", cloud)
    assert "label" in vertex_properties(tmp_path / "a.ply")
    assert list(read_ply_vertices(tmp_path / "a.ply")[0]) == vertex_properties(tmp_path / "a.ply")


def test_transformed_scales_rotates_and_moves(cloud):
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = cloud.transformed(2.0, quarter, (0, 0, 5))
    expected = 2 * np.column_stack([-cloud.points[:, 1], cloud.points[:, 0], cloud.points[:, 2]])
    np.testing.assert_allclose(moved.points, expected + [0, 0, 5])
    np.testing.assert_allclose(
        np.linalg.norm(moved.normals, axis=1), np.linalg.norm(cloud.normals, axis=1), rtol=1e-5
    )
