"""Named scenes: the demo trees, and captures as people walk them."""

from cherrypicker_lab.orchard.scene.cameras import CameraModel, Ring

PRESETS = {
    "cherry_leader": {
        "scene": {
            "seed": 2101, "habit": "leader", "height": 2.2, "trunk_radius": 0.036,
            "density": 0.85, "sky": "broken", "neighbours": 2, "row_spacing": 3.7,
            "sign": True, "ring": True, "cube": False, "post": False, "roof": False,
            "markers": [
                {"dictionary": "DICT_4X4_50", "id": 7, "side_m": 0.25, "pose": "lying",
                 "xy": (0.12, -0.60), "azimuth": 1.75, "tilt": 0.18},
            ],
        },
        "camera": CameraModel(),
        "rings": [
            Ring(20, 1.10, 2.40, 1.02),
            Ring(20, 1.90, 2.35, 1.05, 0.16),
            Ring(8, 0.55, 2.30, 1.12, 0.3),
        ],
    },
    "cherry_vase": {
        "scene": {
            "seed": 2208, "habit": "vase", "height": 2.05, "trunk_radius": 0.045,
            "density": 0.7, "sky": "overcast", "neighbours": 1, "row_spacing": 3.8,
            "sign": {"xy": (-0.95, -0.55), "top": 0.38, "width": 0.22},
            "ring": False, "cube": True, "post": False, "roof": False,
            "markers": [
                {"dictionary": "DICT_5X5_100", "id": 23, "side_m": 0.22, "pose": "lying",
                 "xy": (-0.58, 0.37), "azimuth": -0.5, "tilt": 0.12},
                {"dictionary": "DICT_5X5_100", "id": 24, "side_m": 0.15, "pose": "standing",
                 "xy": (0.75, 0.45), "azimuth": -2.6},
            ],
        },
        "camera": CameraModel(focal_px=1000.0, model="Orchard Two", sensor_diagonal_mm=7.8),
        "rings": [
            Ring(20, 1.05, 2.55, 1.06, 0.05),
            Ring(20, 1.85, 2.50, 1.12, 0.2),
            Ring(8, 0.60, 2.45, 1.15, 0.1),
        ],
    },
}  # fmt: skip


def _walk_preset(walk, background, n_photos, camera, marker, **scene):
    """A capture as people walk it; `marker` is (dictionary, id, side m, x, y, azimuth)."""
    dictionary, number, side, x, y, azimuth = marker
    lying = {
        "dictionary": dictionary, "id": number, "side_m": side, "pose": "lying", "xy": (x, y),
        "azimuth": azimuth, "tilt": 0.15,
    }  # fmt: skip
    things = dict.fromkeys(("cube", "post", "roof", "ring"), False) | {"sign": True}
    return {
        "scene": {
            **things, "relief": 0.6, "spurs": 5.0, "tip_radius": (0.0015, 0.0022),
            "background": background, "markers": [lying], **scene,
        },
        "camera": camera, "walk": walk, "n_photos": n_photos,
    }  # fmt: skip


# 0.67 megapixels: two cores take a scene's stereo from photos to cloud in minutes
_WIDE = CameraModel(1000, 667, 800.0, model="Orchard Seven", sensor_diagonal_mm=28.2)
_TALL = CameraModel(667, 1000, 830.0, model="Orchard Eight", sensor_diagonal_mm=9.5)
WALK_PRESETS = {
    "walk_alleys_hills": _walk_preset(
        "alleys", "hills", 56, _WIDE, ("DICT_4X4_50", 12, 0.24, 0.35, -0.65, 1.2),
        seed=7101, habit="cherry_vase", height=3.0, trunk_radius=0.062, density=1.4,
        sky="broken", neighbours=2, row_spacing=4.2, ground="grass",
    ),
    "walk_low_rings_hedges": _walk_preset(
        "low_rings", "hedges", 52, _WIDE, ("DICT_5X5_100", 31, 0.22, -0.6, 0.45, -0.7),
        seed=7202, habit="cherry_leader", height=2.8, trunk_radius=0.05, density=1.2,
        sky="clear", neighbours=1, row_spacing=4.0, ground="meadow",
    ),
    "walk_spiral_rows": _walk_preset(
        "spiral", "rows", 54, _TALL, ("DICT_6X6_250", 8, 0.25, 0.55, 0.5, 2.4),
        seed=7303, habit="cherry_spindle", height=3.2, trunk_radius=0.055, density=1.2,
        sky="overcast", neighbours=2, row_spacing=3.8, ground="herbicide", ring=True,
    ),
    "walk_alleys_buildings": _walk_preset(
        "alleys", "buildings", 60, _TALL, ("DICT_APRILTAG_36h11", 17, 0.26, -0.5, -0.6, 0.3),
        seed=7404, habit="cherry_leader", height=3.5, trunk_radius=0.065, density=1.1,
        sky="broken", neighbours=2, row_spacing=4.2, ground="grass",
    ),
    "walk_half_ring_hills": _walk_preset(
        "half_ring", "hills", 44, _WIDE, ("DICT_4X4_50", 21, 0.24, 0.2, 0.7, -2.0),
        seed=7505, habit="vase", height=2.6, trunk_radius=0.055, density=1.6, tip_radius=None,
        sky="clear", neighbours=2, row_spacing=4.0, ground="grass",
    ),
    "walk_low_rings_rows": _walk_preset(
        "low_rings", "rows", 56, _WIDE, ("DICT_5X5_100", 44, 0.25, 0.6, -0.5, 1.0),
        seed=7607, habit="cherry_vase", height=3.3, trunk_radius=0.07, density=1.4,
        sky="clear", neighbours=2, row_spacing=4.4, ground="mulch",
    ),
}  # fmt: skip
PRESETS |= WALK_PRESETS
