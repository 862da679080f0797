import numpy as np
import pytest

from cherrypicker.errors import StageError
from cherrypicker.intake.clouds import HeightOptions, check_height, import_cloud
from cherrypicker.pointcloud import PointCloud, write_cloud

ANY_HEIGHT = HeightOptions((0.0, 1e9))


@pytest.fixture
def ply(tmp_path):
    points = np.random.default_rng(0).uniform([0, 0, 0], [1000, 800, 3000], (40, 3))
    write_cloud(tmp_path / "scan.ply", PointCloud(points))
    return tmp_path / "scan.ply", points


@pytest.mark.parametrize("axis", ["x", "-x", "y", "-y", "z", "-z"])
def test_the_up_axis_becomes_z_by_a_rotation(ply, axis):
    path, points = ply
    moved = import_cloud(path, up=axis, heights=ANY_HEIGHT).points
    upward = points[:, "xyz".index(axis[-1])]
    np.testing.assert_array_equal(moved[:, 2], -upward if axis[0] == "-" else upward)
    rotation = np.linalg.lstsq(points, moved, rcond=None)[0].T
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0)
    if axis == "-z":  # half a turn about x
        np.testing.assert_array_equal(moved, points * [1, -1, -1])


@pytest.mark.parametrize(
    ("unit", "factor"), [("mm", 0.001), ("cm", 0.01), ("ft", 0.3048), ("2.5", 2.5)]
)
def test_units_and_order(ply, unit, factor):
    path, points = ply
    cloud = import_cloud(path, unit=unit, heights=ANY_HEIGHT)
    np.testing.assert_allclose(cloud.points, factor * points, rtol=1e-6)
    assert cloud.unit == "m"


def test_a_given_scale_wins_over_the_unit(ply):
    path, points = ply
    np.testing.assert_allclose(
        import_cloud(path, unit="mm", scale="2", heights=ANY_HEIGHT).points, 2 * points, rtol=1e-6
    )


def test_no_scale_normalises_the_height_and_says_so(ply):
    cloud = import_cloud(ply[0], scale="none")
    assert np.ptp(cloud.points[:, 2]) == pytest.approx(3.0)
    assert cloud.unit == "arbitrary"


def test_las_keeps_geographic_coordinates(tmp_path):
    laspy = pytest.importorskip("laspy")
    points = np.random.default_rng(0).uniform([5e5, 5e6, 300], [5e5 + 3, 5e6 + 3, 304], (30, 3))
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.offsets, header.scales = points.min(0), [1e-4] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.red = las.green = las.blue = np.full(30, 65535, dtype=np.uint16)
    las.write(tmp_path / "scan.laz")
    cloud = import_cloud(tmp_path / "scan.laz")
    np.testing.assert_allclose(cloud.points, points, atol=1e-4)
    np.testing.assert_allclose(cloud.colors, 1.0)


@pytest.mark.parametrize("text", ["1 2 3\n4 5 6\n", "x,y,z\n1,2,3\n4,5,6\n", "1;2;3\n4;5;6\n"])
def test_text_clouds(tmp_path, text):
    (tmp_path / "scan.xyz").write_text(text)
    np.testing.assert_array_equal(
        import_cloud(tmp_path / "scan.xyz").points, [[1, 2, 3], [4, 5, 6]]
    )


@pytest.mark.parametrize("name", ["scan.xyz", "scan.las", "scan.ply", "scan.obj", "absent.ply"])
def test_what_is_no_cloud_is_refused(tmp_path, name):
    if "absent" not in name:
        (tmp_path / name).write_text("no numbers here")
    with pytest.raises(StageError) as error:
        import_cloud(tmp_path / name)
    assert name in str(error.value)


def test_labels_out_of_range_are_refused(tmp_path):
    labels = np.array([1, 2, 99], dtype=np.uint8)
    write_cloud(tmp_path / "a.ply", PointCloud(np.eye(3), fields={"label": labels}))
    with pytest.raises(StageError, match="99"):
        import_cloud(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("unit", "scale", "told"),
    [
        ("m", "", "more than 60 m.*cloud_unit in trees.tsv, or scale.height_range_m"),
        ("mm", "0.00001", "less than 0.1 m.*scale in trees.tsv, or scale.height_range_m"),
    ],
)
def test_a_height_that_no_tree_has_is_refused_until_a_key_says_so(ply, unit, scale, told):
    path, points = ply
    with pytest.raises(StageError, match=told) as caught:
        import_cloud(path, unit=unit, scale=scale)
    assert caught.value.file == str(path)
    heights = HeightOptions((0.001, 4000.0))
    assert len(import_cloud(path, unit=unit, scale=scale, heights=heights)) == len(points)
    assert len(import_cloud(path, unit="mm")) == len(points), "3 m is a tree"
    assert import_cloud(path, scale="none").unit == "arbitrary"


def test_a_cloud_without_a_unit_has_any_height():
    tall = PointCloud(np.array([[0, 0, 0], [0, 0, 99.0]]), unit="arbitrary")
    check_height(tall, HeightOptions(), "x")
    check_height(PointCloud(np.ones((1, 3)), unit="m"), HeightOptions(), "x")
    tall.unit = "m"
    with pytest.raises(StageError, match="99 m high"):
        check_height(tall, HeightOptions(), "x")
    with pytest.raises(StageError, match="60 to 1 m.*scale.height_range_m"):
        check_height(tall, HeightOptions((60.0, 1.0)), "x")


@pytest.mark.parametrize("name", ["a.ply", "a.las", "a.xyz"])
def test_a_file_of_another_kind_names_the_column(tmp_path, name):
    (tmp_path / name).write_text("a text\n")
    with pytest.raises(StageError, match=rf"not .*; file: .*{name}; change: cloud in trees.tsv"):
        import_cloud(tmp_path / name)
