"""Light against shapes whose silhouettes and shade are known, and against pvlib's own sums."""

import csv
from unittest.mock import patch

import numpy as np
import pandas
import pvlib
import pytest
import trimesh
from finished_tree import small_skeleton, write_finished_tree
from stage_run import run_stage
from workspace import Workspace

from cherrypicker.batch.config import resolve_config
from cherrypicker.errors import StageError
from cherrypicker.files import csv_text, load_yaml, read_json, write_text
from cherrypicker.formats.measured import MeasuredTree, read_measured_tree
from cherrypicker.light.measure import LightOptions, light_sums, measure_light
from cherrypicker.light.mesh import PartMesh, leaf_mesh, wood_mesh
from cherrypicker.light.rays import cast_cuts, cast_silhouettes
from cherrypicker.light.sky import SeasonLight, season_light, sky_directions
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branches_csv
from cherrypicker.traits.table import LIMB_COLUMNS

PLACE, YEAR_PART = (49.6, 11.0), ("2026-04-01", "2026-09-30")
UP = np.array([[0.0, 0.0, 1.0]])


def mesh_of(*shapes, is_leaf=False):
    """Shapes (vertices, triangles) as parts of one mesh."""
    whole = None
    for vertices, triangles in shapes:
        n = len(triangles)
        one = PartMesh(
            np.asarray(vertices, float),
            np.asarray(triangles),
            *(np.zeros(n, int), np.zeros(n, int), np.zeros(1, int)),
            np.array([is_leaf]),
        )
        whole = one if whole is None else whole.with_parts(one)
    return whole


def plate(width, depth, center, normal=(0, 0, 1)):
    """A flat rectangle; `depth` lies along y."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    across = np.cross(normal, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2 * (width, depth)
    return corners @ [across, np.cross(normal, across)] + center, [[0, 1, 2], [0, 2, 3]]


def rods(*ends_and_radii):
    """Straight axes from one root: the first is the trunk, the others hang on its first node."""
    points, parent, radius = [], [], []
    for number, (start, end, thickness) in enumerate(ends_and_radii):
        share = np.linspace(0, 1, 21)[int(number > 0) :, None]
        parent += [0 if number else -1, *range(len(points), len(points) + len(share) - 1)]
        points += list(np.asarray(start) + share * (np.asarray(end, float) - start))
        radius += [thickness] * len(share)
    skeleton = Skeleton(points, parent, radius, np.ones(len(points)))
    found = axes(skeleton)
    return MeasuredTree("rods", skeleton, found)


def cast(mesh, directions, n_rays):
    with patch("cherrypicker.light.rays.N_RAYS", n_rays):
        return cast_silhouettes(mesh, directions)


def test_a_sphere_shows_its_circle_to_all_sides_and_a_quarter_of_its_surface():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.3)
    mesh = mesh_of((ball.vertices, ball.faces))
    seen = cast(mesh, sky_directions(20), 50_000)
    assert seen.own[:, 0] == pytest.approx(np.pi * 0.3**2, rel=0.005)
    assert np.array_equal(seen.own, seen.lit)
    (sums,) = light_sums(mesh, seen, np.zeros(1), None, np.zeros(1, int), 1)
    assert sums["star"] == pytest.approx(0.25, rel=0.005)
    assert sums["sky_share"] == 1


def test_a_plate_shows_its_area_times_the_cosine_and_gets_what_the_ground_gets():
    mesh = mesh_of(plate(0.4, 0.6, (1, 2, 3)))
    directions = sky_directions()
    seen = cast(mesh, directions, 20_000)
    assert seen.own[:, 0] == pytest.approx(0.24 * directions[:, 2], rel=0.01, abs=1e-4)
    light = SeasonLight(*np.outer([0.0, 14.0 / len(directions)], np.ones(len(directions))))
    (sums,) = light_sums(mesh, seen, np.zeros(1), light, np.zeros(1, int), 1)
    assert sums["diffuse_mj"] == pytest.approx(7.0 * 0.24, rel=0.01)


def test_a_level_rod_shows_a_rectangle_and_its_ends():
    length, radius = 1.0, 0.02
    mesh = wood_mesh(rods(((0, 0, 0), (length, 0, 0), radius)))
    directions = sky_directions(30)
    seen = cast(mesh, directions, 50_000)
    along = np.abs(directions[:, 0])
    exact = 2 * radius * length * np.sqrt(1 - along**2) + np.pi * radius**2 * along
    assert seen.own[:, 0] == pytest.approx(exact, rel=0.01)
    assert mesh.areas()[0] == pytest.approx(2 * np.pi * radius * (length + radius), rel=0.005)


def test_an_upper_plate_shades_a_lower_one_and_what_it_shades_moves_with_the_light():
    low, high = plate(1.0, 1.0, (0, 0, 0)), plate(0.5, 0.5, (0, 0, 0.2))
    slant = np.array([np.sin(1.0), 0, np.cos(1.0)])
    seen = cast_silhouettes(mesh_of(low, high), np.array([UP[0], slant]))
    assert seen.lit[0] == pytest.approx([0.75, 0.25], rel=0.01)
    # The shadow's middle lies 0.2 tan 1 = 0.311 aside, so 0.061 of its width has left the plate
    shadow = 0.5 * (0.5 - (0.2 * np.tan(1.0) + 0.25 - 0.5))
    assert seen.lit[1] == pytest.approx([np.cos(1.0) * (1 - shadow), np.cos(1.0) / 4], rel=0.01)
    assert seen.own[0] == pytest.approx([1.0, 0.25], rel=0.01)


def test_what_lies_under_a_plate_comes_to_light_with_the_cut_that_takes_it():
    low, middle, high = (plate(1, 1, (0, 0, z)) for z in (0, 0.1, 0.2))
    mesh = mesh_of(low, middle, high)
    mesh.step = np.repeat([0, 1, 2], 2)
    # First the middle one goes, of which nothing is seen, then the upper one
    (lit, thrice), own = cast_cuts(mesh, UP, np.array([2, 0, 1]), np.array([[1.0], [3.0]]))
    assert lit == pytest.approx(np.array([[0, 0, 1], [0, 0, 1], [1, 0, 0]]), abs=1e-3)
    assert thrice == pytest.approx(3.0 * lit)
    assert own == pytest.approx(np.array([[1, 1, 1], [1, 0, 1], [1, 0, 0]]), abs=1e-3)
    # Of one part that goes in two cuts the lower half is alone in the light after the first
    mesh.part, mesh.axis, mesh.is_leaf = (
        np.repeat([0, 1, 1], 2),
        np.zeros(2, int),
        np.zeros(2, bool),
    )
    (lit,), own = cast_cuts(mesh, UP, np.array([2, 1, 0]), np.ones((1, 1)))
    assert lit == pytest.approx(np.array([[0, 1], [0, 1], [1, 0]]), abs=1e-3)
    assert own == pytest.approx(np.array([[1, 1], [1, 1], [1, 0]]), abs=1e-3)
    seen = cast_silhouettes(mesh, UP)
    assert lit[0] == pytest.approx(seen.lit[0]) and own[0] == pytest.approx(seen.own[0])


def test_under_a_hedge_of_many_leaves_light_fades_as_beer_has_it():
    rng = np.random.default_rng(3)
    n, side, width = 22_500, 0.02, 3.0
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    across = np.cross(normals, rng.normal(size=(n, 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(normals, across)
    middle = rng.uniform((-width / 2, -width / 2, 0.1), (width / 2, width / 2, 0.5), (n, 3))
    corners = [
        middle + side / 2 * (a * across + b * up) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    vertices = np.stack(corners, axis=1).reshape(-1, 3)
    quads = 4 * np.arange(n)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    number = np.repeat(np.arange(n), 2)
    leaves = PartMesh(
        vertices, quads.reshape(-1, 3), number, 0 * number, np.zeros(n, int), np.ones(n, bool)
    )
    mesh = mesh_of(plate(2.0, 2.0, (0, 0, 0))).with_parts(leaves)
    slant = np.array([np.sin(0.6), 0, np.cos(0.6)])
    seen = cast(mesh, np.array([UP[0], slant]), 1_000_000)
    leaf_area_index = n * side**2 / width**2
    for lit, own, cosine in zip(seen.lit[:, 0], seen.own[:, 0], (1.0, slant[2]), strict=True):
        assert lit / own == pytest.approx(np.exp(-leaf_area_index / 2 / cosine), rel=0.015)


def test_a_wall_in_a_row_shades_the_next_up_to_where_the_sun_looks_over():
    mesh = mesh_of(plate(2.0, 1.0, (0, 0, 1.0), normal=(1, 0, 0)))
    height = np.radians(40.0)
    sun = np.array([[np.cos(height), 0, np.sin(height)], [0.01, np.cos(height), np.sin(height)]])
    sun /= np.linalg.norm(sun, axis=1)[:, None]
    seen = cast_silhouettes(mesh, sun, row_step=np.array([1.5, 0, 0]))
    shaded = 1 - 1.5 * np.tan(height) / 2.0
    assert seen.lit[0, 0] / seen.own[0, 0] == pytest.approx(1 - shaded, rel=0.01)
    assert seen.lit[1, 0] == seen.own[1, 0]  # along the wall


@pytest.mark.parametrize("day", ["2026-03-21", "2026-06-21", "2026-12-21"])
def test_a_days_direct_and_diffuse_light_on_the_ground_are_pvlibs(day):
    directions = sky_directions()
    found = season_light(directions, *PLACE, (day, day))
    times = pandas.date_range(day, periods=24 * 60, freq="1min", tz="UTC")
    location = pvlib.location.Location(*PLACE)
    sun = location.get_solarposition(times)
    sky = location.get_clearsky(times, solar_position=sun)
    level = sky["dni"] * np.sin(np.radians(sun["apparent_elevation"].clip(lower=0)))
    assert found.beam @ directions[:, 2] == pytest.approx(level.sum() * 60e-6, rel=0.01)
    assert found.beam.sum() == pytest.approx(sky["dni"].sum() * 60e-6, rel=0.01)
    assert found.diffuse.sum() / 2.0 == pytest.approx(sky["dhi"].sum() * 60e-6, rel=0.01)


def test_the_sun_stands_where_north_says():
    directions = sky_directions()
    for north, south in ((90.0, (0, -1, 0)), (0.0, (-1, 0, 0))):
        beam = season_light(directions, *PLACE, ("2026-12-21", "2026-12-21"), north_deg=north).beam
        mean = beam @ directions
        assert mean[:2] / np.linalg.norm(mean[:2]) == pytest.approx(south[:2], abs=0.02)


@pytest.fixture(scope="module")
def tree():
    skeleton = small_skeleton()
    found = axes(skeleton)
    return MeasuredTree("small", skeleton, found)


def measured(tree, **given):
    """With few rays, as what is compared is of the same ones."""
    with patch("cherrypicker.light.rays.N_RAYS", 10_000):
        return measure_light(tree, [1, 2], LightOptions(PLACE, YEAR_PART, **given))


@pytest.fixture(scope="module")
def alone(tree):
    return measured(tree)


def test_limbs_carry_their_axes_and_all_adds_up(tree, alone):
    totals, rows = alone
    assert [row["branch_id"] for row in rows] == list(range(len(tree.axis_list)))
    for name in ("area_m2", "silhouette_m2", "direct_mj", "diffuse_mj", "shaded_length_m"):
        assert totals[name] == pytest.approx(sum(row[name] for row in rows), rel=1e-4)
        for limb in totals["limbs"]:
            own = sum(row[name] for row in rows if row["limb_rank"] == limb["rank"])
            assert limb[name] == pytest.approx(own, rel=1e-3)
    assert all(0.5 < row["sky_share"] <= 1 and 0.1 < row["star"] <= 0.25 for row in rows)
    assert measured(tree) == alone


def test_neighbours_and_leaves_take_light_from_the_wood(tree, alone):
    row, _ = measured(tree, row_spacing_m=0.8)
    leafy, of_axes = measured(tree, leaf_area_cm2=20)
    assert row["row_spacing_m"] == 0.8 and row["season"] == leafy["season"] == YEAR_PART
    for name in ("sky_share", "direct_mj", "diffuse_mj"):
        assert row[name] < alone[0][name] and leafy[name] < alone[0][name]
    assert leafy["leaf_area_m2"] == pytest.approx(sum(each["leaf_area_m2"] for each in of_axes))
    assert 0 < leafy["leaf_sky_share"] < 1


def test_what_has_no_surface_has_no_share_of_the_light():
    mesh = mesh_of(plate(1, 1, (0, 0, 0)), is_leaf=True)
    seen = cast(mesh, sky_directions(), 500)
    leafy, bare = light_sums(mesh, seen, np.zeros(1), None, np.zeros(1, int), 2)
    assert leafy["leaf_sky_share"] == pytest.approx(1.0) and leafy["leaf_star"] > 0
    assert bare["leaf_sky_share"] is None and bare["leaf_star"] is None
    assert csv_text([bare], bare).splitlines()[1] == "0.0,0.0,,"


def test_leaves_stand_at_equal_ways_within_half_a_metre_of_the_tips():
    tree = rods(((0, 0, 0), (1.0, 0, 0), 0.02), ((0, 0, 0), (0, 0, 0.3), 0.004))
    leaves = leaf_mesh(tree, 0.004)
    assert leaves.areas() == pytest.approx(2 * 0.004)
    assert np.bincount(leaves.axis).tolist() == [19, 11]
    feet = leaves.vertices[::4]
    far = np.linalg.norm(feet[leaves.axis == 0] - [1, 0, 0], axis=1)
    assert far.max() < 0.5 and np.array_equal(np.diff(leaves.part) >= 0, np.full(59, True))


@pytest.mark.parametrize(
    "given, key",
    [
        ({"place_deg": PLACE}, "light.season"),
        ({"season": YEAR_PART}, "light.place_deg"),
        ({"place_deg": PLACE, "season": YEAR_PART[::-1]}, "light.season"),
    ],
)
def test_half_a_place_or_season_is_refused_by_its_key(tree, given, key):
    with pytest.raises(StageError) as refused:
        measure_light(tree, [], LightOptions(**given))
    assert refused.value.key == key


def test_metres_are_not_asked_of_a_tree_without_a_scale():
    skeleton = small_skeleton()
    skeleton.unit = "arbitrary"
    found = axes(skeleton)
    tree = MeasuredTree("unscaled", skeleton, found)
    with pytest.raises(StageError, match="needs a scale"):
        measure_light(tree, [], LightOptions(leaf_area_cm2=20))


def test_dates_are_read_as_yaml_has_them(project):
    schema = load_yaml(project / "workflow/schemas/config.schema.yaml")
    season = [pandas.Timestamp(day).date() for day in YEAR_PART]
    place = {"place_deg": [48.0, 8.0]}
    given = resolve_config(schema, {"light": {**place, "season": season}})
    assert given["light"]["season"] == [*YEAR_PART]
    with pytest.raises(StageError, match=r"light.season.1"):
        resolve_config(schema, {"light": {**place, "season": ["2026-04-01", "2026-13-01"]}})


def test_the_stage_writes_a_row_an_axis(tmp_path, monkeypatch):
    folder = tmp_path / "tree"
    monkeypatch.setattr("cherrypicker.light.rays.N_RAYS", 2000)
    skeleton = write_finished_tree(folder)
    write_text(folder / "limbs.csv", branches_csv([], LIMB_COLUMNS))
    files = {"skeleton": "skeleton.graphml", "limbs": "limbs.csv"}
    files |= {"axes": "light.csv", "light": "light.json"}
    run_stage("measure_light", **{name: folder / file for name, file in files.items()})
    with open(folder / "light.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(axes(skeleton)) == len(read_measured_tree(folder).axis_list)
    assert read_json(folder / "light.json")["limbs"] == []
    assert "direct_mj" not in rows[0]


def test_light_is_measured_of_the_trees_whose_config_asks_for_it(tmp_path):
    workspace = Workspace(tmp_path / "work")
    for tree in "ab":
        workspace.add_cloud(tree)
    workspace.configure({"light": {"enabled": True}}, "b.yaml")
    workspace.table("tree | cloud | config", "a | a.ply | ", "b | b.ply | config/b.yaml")
    assert [tree for stage, tree in workspace.planned() if stage == "measure_light"] == ["b"]
