"""Templates of Weber and Penn trees: three conifers and six trained forms of the sweet cherry.

The conifers start from the published parameter sets of C. Hewitt, "Procedural generation of tree
models for use in computer graphics" (2017; Douglas fir, European larch, small pine: angles, curves,
rotations, power of the ratio, shape) at the size of an orchard tree: 2 to 4 m instead of 6 to 40,
fewer branches and a thick trunk for the height, as the 50 trees of Meyer et al. (2023) were made
("relatively thick trunks and thin branches"). The cherries are ours: spindle and leader after the
angles of trained trees, the vase by base splits, the whip a one-year-old tree, leader and vase of
the `BEARING` age after decades: stems of 8 to 20 cm, scaffolds of 3 to 10 cm, see `ageing`.
"""

from dataclasses import replace

from cherrypicker_lab.orchard.grow.ageing import Ageing
from cherrypicker_lab.orchard.grow.growth import grow_tree
from cherrypicker_lab.orchard.grow.weber_penn import Level, Parameters, grow_weber_penn

TEMPLATES = {
    "fir": Parameters(
        "fir",
        (
            Level(curve_res=4, curve_v=12.0, bend_v=12.0),
            Level(branches=58, length=0.31, length_v=0.04, down_angle=84.0, down_angle_v=-22.0,
                  rotate=140.0, rotate_v=40.0, curve=-35.0, curve_v=35.0, bend_v=40.0, whorl=3),
            Level(branches=9, length=0.42, length_v=0.08, down_angle=52.0, down_angle_v=10.0,
                  rotate=-180.0, rotate_v=25.0, curve=-10.0, curve_v=40.0, bend_v=30.0,
                  curve_res=3),
            Level(branches=4, length=0.45, length_v=0.1, down_angle=45.0, down_angle_v=10.0,
                  rotate=-160.0, rotate_v=30.0, curve_v=30.0, bend_v=20.0, curve_res=2),
        ),
        height=(2.6, 3.8), ratio=(0.017, 0.025), ratio_power=1.2, shape=0,
        base_size=(0.14, 0.22), flare=0.4, tip_radius=(0.003, 0.006),
    ),
    "larch": Parameters(
        "larch",
        (
            Level(curve_res=8, curve_v=24.0, bend_v=24.0),
            Level(branches=40, length=0.36, length_v=0.05, down_angle=66.0, down_angle_v=-26.0,
                  rotate=70.0, rotate_v=30.0, curve=22.0, curve_back=-70.0, curve_v=70.0,
                  bend_v=40.0, curve_res=10),
            Level(branches=13, length=0.40, length_v=0.1, down_angle=68.0, down_angle_v=22.0,
                  rotate=-170.0, rotate_v=40.0, curve=12.0, curve_v=40.0, bend_v=30.0,
                  seg_splits=0.08, split_angle=40.0, split_angle_v=10.0, curve_res=5),
            Level(branches=3, length=0.42, length_v=0.1, down_angle=50.0, down_angle_v=15.0,
                  rotate=120.0, rotate_v=30.0, curve_v=30.0, bend_v=20.0, curve_res=2),
        ),
        height=(2.6, 3.8), ratio=(0.015, 0.022), ratio_power=1.2, shape=0,
        base_size=(0.18, 0.28), flare=0.3, attraction_up=-0.25, tip_radius=(0.003, 0.006),
    ),
    "pine": Parameters(
        "pine",
        (
            Level(curve_res=5, curve_v=14.0, bend_v=14.0),
            Level(branches=40, length=0.42, length_v=0.05, down_angle=58.0, down_angle_v=-24.0,
                  rotate=140.0, rotate_v=30.0, curve=-28.0, curve_v=60.0, bend_v=60.0,
                  curve_res=6, seg_splits=0.22, split_angle=42.0, split_angle_v=12.0, whorl=5),
            Level(branches=9, length=0.38, length_v=0.08, down_angle=42.0, down_angle_v=10.0,
                  rotate=140.0, rotate_v=25.0, curve=-25.0, curve_v=40.0, bend_v=40.0, curve_res=4),
            Level(branches=3, length=0.40, length_v=0.1, down_angle=38.0, down_angle_v=10.0,
                  rotate=140.0, rotate_v=30.0, curve_v=30.0, bend_v=30.0, curve_res=2),
        ),
        height=(2.3, 3.2), ratio=(0.020, 0.028), ratio_power=1.3, shape=0,
        base_size=(0.08, 0.16), flare=0.3, attraction_up=0.2, tip_radius=(0.003, 0.006),
    ),
    "cherry_leader": Parameters(
        "cherry_leader",
        (
            Level(curve_res=8, curve_v=20.0, bend_v=20.0),
            Level(branches=22, length=0.42, length_v=0.06, down_angle=60.0, down_angle_v=-10.0,
                  rotate=137.5, rotate_v=14.0, curve=-30.0, curve_v=60.0, bend_v=60.0,
                  curve_res=7),
            Level(branches=8, length=0.48, length_v=0.12, down_angle=50.0, down_angle_v=12.0,
                  rotate=-170.0, rotate_v=40.0, curve=-22.0, curve_v=60.0, bend_v=60.0,
                  curve_res=5),
            Level(branches=7, length=0.42, length_v=0.2, down_angle=50.0, down_angle_v=12.0,
                  rotate=-170.0, rotate_v=40.0, curve=-15.0, curve_v=40.0, bend_v=40.0,
                  curve_res=3),
        ),
        height=(1.8, 5.0), ratio=(0.014, 0.024), ratio_power=1.25, shape=0,
        base_size=(0.14, 0.28), flare=0.35, attraction_up=0.35,
    ),
    "cherry_spindle": Parameters(
        "cherry_spindle",
        (
            Level(curve_res=8, curve_v=18.0, bend_v=18.0),
            Level(branches=34, length=0.30, length_v=0.05, down_angle=80.0, down_angle_v=-12.0,
                  rotate=137.5, rotate_v=18.0, curve=-10.0, curve_v=60.0, bend_v=60.0,
                  curve_res=6),
            Level(branches=6, length=0.46, length_v=0.12, down_angle=52.0, down_angle_v=12.0,
                  rotate=-175.0, rotate_v=40.0, curve=-25.0, curve_v=60.0, bend_v=60.0,
                  curve_res=4),
            Level(branches=6, length=0.42, length_v=0.2, down_angle=50.0, down_angle_v=12.0,
                  rotate=-170.0, rotate_v=40.0, curve=-15.0, curve_v=40.0, bend_v=40.0,
                  curve_res=3),
        ),
        height=(1.8, 4.0), ratio=(0.013, 0.021), ratio_power=1.2, shape=4,
        base_size=(0.18, 0.28), flare=0.35, attraction_up=0.15,
    ),
    "cherry_vase": Parameters(
        "cherry_vase",
        (
            Level(curve_res=4, curve_v=12.0, bend_v=12.0, split_angle=38.0, split_angle_v=9.0),
            Level(curve=-14.0, curve_v=45.0, bend_v=45.0, curve_res=7),
            Level(branches=9, length=0.44, length_v=0.1, down_angle=52.0, down_angle_v=12.0,
                  rotate=137.5, rotate_v=30.0, curve=-30.0, curve_v=60.0, bend_v=60.0,
                  curve_res=5),
            Level(branches=9, length=0.40, length_v=0.2, down_angle=50.0, down_angle_v=12.0,
                  rotate=-170.0, rotate_v=40.0, curve=-15.0, curve_v=40.0, bend_v=40.0,
                  curve_res=3),
        ),
        height=(1.8, 5.0), ratio=(0.017, 0.028), ratio_power=1.1, shape=3,
        base_size=(0.20, 0.34), flare=0.35, base_splits=(3, 5), attraction_up=0.3,
    ),
    "cherry_whip": Parameters(
        "cherry_whip",
        (
            Level(curve_res=6, curve_v=20.0, bend_v=20.0),
            Level(branches=8, length=0.30, length_v=0.12, down_angle=52.0, down_angle_v=-10.0,
                  rotate=137.5, rotate_v=20.0, curve=-30.0, curve_v=40.0, bend_v=40.0,
                  curve_res=5),
            Level(branches=3, length=0.34, length_v=0.15, down_angle=48.0, down_angle_v=12.0,
                  rotate=-170.0, rotate_v=40.0, curve=-20.0, curve_v=40.0, bend_v=40.0,
                  curve_res=3),
        ),
        height=(1.0, 1.8), ratio=(0.011, 0.017), ratio_power=1.3, shape=4,
        base_size=(0.35, 0.6), flare=0.25, attraction_up=0.3,
    ),
    "bearing_leader": Parameters(
        "bearing_leader",
        (
            Level(curve_res=8, curve_v=30.0, bend_v=30.0),
            Level(branches=18, length=0.46, length_v=0.05, down_angle=62.0, down_angle_v=-10.0,
                  rotate=137.5, rotate_v=14.0, curve=-35.0, curve_v=80.0, bend_v=80.0,
                  curve_res=7),
            Level(branches=10, length=0.40, length_v=0.10, down_angle=52.0, down_angle_v=14.0,
                  rotate=-170.0, rotate_v=40.0, curve=-25.0, curve_v=70.0, bend_v=70.0,
                  curve_res=5),
            Level(branches=8, length=0.40, length_v=0.2, down_angle=50.0, down_angle_v=14.0,
                  rotate=-170.0, rotate_v=40.0, curve=-15.0, curve_v=50.0, bend_v=50.0,
                  curve_res=3),
        ),
        height=(2.8, 4.0), ratio=(0.018, 0.025), ratio_power=1.2, shape=0,
        base_size=(0.18, 0.28), flare=0.6, attraction_up=0.35, ageing=Ageing(),
    ),
    "bearing_vase": Parameters(
        "bearing_vase",
        (
            Level(curve_res=4, curve_v=18.0, bend_v=18.0, split_angle=33.0, split_angle_v=7.0),
            Level(curve=-18.0, curve_v=60.0, bend_v=60.0, curve_res=7),
            Level(branches=14, length=0.34, length_v=0.07, down_angle=54.0, down_angle_v=14.0,
                  rotate=137.5, rotate_v=30.0, curve=-30.0, curve_v=70.0, bend_v=70.0,
                  curve_res=5),
            Level(branches=12, length=0.40, length_v=0.2, down_angle=50.0, down_angle_v=14.0,
                  rotate=-170.0, rotate_v=40.0, curve=-15.0, curve_v=50.0, bend_v=50.0,
                  curve_res=3),
        ),
        height=(2.5, 3.5), ratio=(0.019, 0.029), ratio_power=1.1, shape=3,
        base_size=(0.22, 0.32), flare=0.6, base_splits=(3, 5), attraction_up=0.4, ageing=Ageing(),
    ),
}  # fmt: skip
CONIFERS = ("fir", "larch", "pine")
BEARING = ("bearing_leader", "bearing_vase")


def grow_any(seed, habit, *, height=None, trunk_radius=None, density=1.0, tip_radius=None):
    """Grow a tree of a template of this module or of a habit of `growth`.

    `habit` is a key of `TEMPLATES`, a `Parameters`, or what `growth.grow_tree` takes; height, trunk
    radius and density are as in `grow_weber_penn`. `tip_radius` is (low, high) of the tips' radii,
    m; the template's own by default. Raises a ValueError if there is no such form.
    """
    options = {"height": height, "trunk_radius": trunk_radius, "density": density}
    parameters = TEMPLATES.get(habit) if isinstance(habit, str) else habit
    if not isinstance(parameters, Parameters):
        if tip_radius is not None:
            raise ValueError(f"{habit!r} has no tip radius to set: it is no Weber and Penn tree")
        return grow_tree(seed, habit, **options)
    if tip_radius is not None:
        parameters = replace(parameters, tip_radius=tuple(tip_radius))
    return grow_weber_penn(seed, parameters, **options)
