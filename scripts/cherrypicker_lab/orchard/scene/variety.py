"""What the scenes of an orchard have: forms, sizes, things, light and cameras drawn from a seed."""

from dataclasses import replace

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker_lab.orchard.grow.growth import HABITS
from cherrypicker_lab.orchard.grow.templates import BEARING, CONIFERS, TEMPLATES
from cherrypicker_lab.orchard.scene.cameras import CameraModel
from cherrypicker_lab.orchard.scene.ground import GROUNDS
from cherrypicker_lab.orchard.scene.layout import DICTIONARIES
from cherrypicker_lab.orchard.scene.structures import NETS
from cherrypicker_lab.orchard.scene.surroundings import BACKGROUNDS
from cherrypicker_lab.orchard.scene.walks import WALKS

FORMS = (*HABITS, *TEMPLATES)
# heights m, and trunk radius per height: from a whip to the tallest trees of an old orchard
HEIGHTS = {"cherry_whip": (1.0, 2.0), None: (1.3, 6.0)}
HEIGHTS |= {form: TEMPLATES[form].height for form in BEARING}
RATIOS = {"cherry_whip": (0.011, 0.016), None: (0.014, 0.026)}
RATIOS |= {form: TEMPLATES[form].ratio for form in BEARING}
RADIUS_M = (0.02, 0.15)
BEARING_SHARE = 0.2  # of the scenes; a guess
WHIP_RADIUS_M = 0.008
LEAST_SIZE_PX = 64
# keys of the config and the options of `generate_scene` that they set
CHOSEN = {
    "sky": "sky", "ground": "ground", "net": "net", "wind_m": "wind", "buds_per_m": "buds",
    "relief": "relief", "neighbours": "neighbours",
}  # fmt: skip
# added later: drawn only where the config says so, so that older seeds keep their scenes
LATER = ("walk", "background", "skeleton")
CAMERAS = (
    CameraModel(800, 1200, 1050.0, model="Orchard One", sensor_diagonal_mm=9.5),
    CameraModel(1200, 800, 860.0, model="Orchard Three", sensor_diagonal_mm=28.2),
    CameraModel(960, 1280, 1130.0, model="Orchard Four", sensor_diagonal_mm=9.5),
    CameraModel(1280, 960, 960.0, model="Orchard Five", sensor_diagonal_mm=12.1),
    CameraModel(1200, 900, 1180.0, model="Orchard Six", sensor_diagonal_mm=43.3),
)


def bearing_form(seed):
    """A form of `BEARING` for a fifth of the seeds, None for the others.

    It is drawn apart from all else, so that those keep the scenes of older versions.
    """
    apart = np.random.default_rng([int(seed), 479])
    is_bearing, form = apart.random() < BEARING_SHARE, str(apart.choice(BEARING))
    return form if is_bearing else None


def scene_options(seed, forms=FORMS, chosen=None):
    """Draw the JSON-able options of `generate_scene` for one scene of an orchard.

    Equal arguments give equal options; the form is one of `forms`. What is not drawn is `chosen`,
    by the keys of the config's `orchard.chosen`: `sky`, `ground`, `net` ("none" for none),
    `wind_m`, `buds_per_m`, `relief`, `neighbours`, `background` ("none" for none, as where it is
    left out), `skeleton` (the file of a tree from elsewhere). "drawn", numbers below 0 and no file
    choose nothing; `walk` is left to `scene_walk`. Raises a `StageError` if a form or a key of
    `chosen` is not known.
    """
    chosen = chosen or {}
    unknown = sorted(set(chosen) - {*CHOSEN, *LATER})
    if unknown:
        raise StageError(
            f"scenes have {', '.join((*CHOSEN, *LATER))} to choose, got {', '.join(unknown)}",
            key="orchard.chosen",
        )
    unknown = [form for form in forms if form not in FORMS]
    if unknown or not forms:
        raise StageError(
            f"forms are some of {', '.join(FORMS)}, got {', '.join(unknown) or 'none'}",
            key="orchard.forms",
        )
    rng = np.random.default_rng([int(seed), 401])
    other = [form for form in forms if form not in BEARING]
    form = str(rng.choice(other or list(forms)))
    if other and bearing_form(seed) in forms:
        form = bearing_form(seed)
    heights, ratios = (table.get(form, table[None]) for table in (HEIGHTS, RATIOS))
    # most orchard trees are low: the logarithm of the height is even
    height = float(np.exp(rng.uniform(*np.log(heights))))
    low = WHIP_RADIUS_M if form == "cherry_whip" else RADIUS_M[0]
    radius = float(np.clip(height * rng.uniform(*ratios), low, RADIUS_M[1]))
    options = {
        "habit": form,
        "height": round(height, 3),
        "trunk_radius": round(radius, 4),
        "density": round(float(rng.uniform(0.6, 1.15)), 3),
        "row_spacing": round(float(max(2.2, 0.9 * height) * rng.uniform(1.0, 1.6)), 3),
        "sky": str(rng.choice(["clear", "broken", "overcast", "low"])),
        "paint": round(float(rng.uniform(0.3, 0.8)), 2) if rng.random() < 0.2 else 0.0,
        "stubs": int(rng.integers(1, 6)) if rng.random() < 0.5 else 0,
        "spurs": round(float(rng.uniform(2, 12)), 1) if form not in CONIFERS else 0.0,
        "wires": int(rng.integers(1, 4)) if rng.random() < 0.3 else 0,
        "markers": [],
    }
    for _ in range(int(rng.choice([1, 2, 3], p=[0.5, 0.3, 0.2]))):
        dictionary = str(rng.choice(DICTIONARIES))
        taken = {(m["dictionary"], m["id"]) for m in options["markers"]}
        number = int(rng.integers(0, 50))
        if (dictionary, number) in taken:
            continue
        pose = str(rng.choice(["lying", "standing", "post"]))
        side = round(float(rng.uniform(0.10, 0.30)), 3)
        options["markers"].append(
            {"dictionary": dictionary, "id": number, "side_m": side, "pose": pose}
        )
    options |= _look(seed, form)
    if skeleton := chosen.get("skeleton", ""):
        options |= {"skeleton": skeleton, "stubs": 0, "spurs": 0.0}
    for key, option in CHOSEN.items():
        value = chosen.get(key, "drawn")
        if not (value == "drawn" if isinstance(value, str) else value < 0):
            options[option] = value
    around = chosen.get("background", "none")
    drawn = str(np.random.default_rng([int(seed), 463]).choice(["none", *BACKGROUNDS]))
    around = drawn if around == "drawn" else around
    if around != "none":
        options["background"] = around
    return {**options, "net": None if options["net"] == "none" else options["net"]}


def scene_walk(seed, chosen=None):
    """Choose how the photographer walks around a scene.

    The `walk` of the config's `orchard.chosen` is one of `walks.WALKS`, or "drawn" for one drawn
    from the seed; there are rings where it is left out.
    """
    walk = (chosen or {}).get("walk", "rings")
    drawn = str(np.random.default_rng([int(seed), 467]).choice(list(WALKS)))
    return drawn if walk == "drawn" else walk


def _look(seed, form):
    """Options of bark, buds, floor, nets and wind."""
    rng = np.random.default_rng([int(seed), 433])
    grounds = [kind for kind in GROUNDS if kind != "meadow"]
    drawn = {
        "ground": "meadow" if rng.random() < 0.4 else str(rng.choice(grounds)),
        "relief": round(float(rng.uniform(0.2, 1.0)), 2),
        "buds": round(float(rng.uniform(15, 40)), 1) if rng.random() < 0.5 else 0.0,
        "net": str(rng.choice(NETS)) if rng.random() < 0.2 else None,
        "wind": round(float(rng.uniform(0.003, 0.03)), 4) if rng.random() < 0.3 else 0.0,
    }
    return drawn if form not in CONIFERS else {**drawn, "buds": 0.0}


def scene_camera(seed, *, distortion=True, size_px=0):
    """Draw the camera of a scene, with a lens of moderate radial `distortion` or a pinhole.

    `size_px` is the longer side of the photos, the field of view staying, 0 for the camera's own.
    Raises a `StageError` if it is above 0 and below `LEAST_SIZE_PX`.
    """
    if 0 < size_px < LEAST_SIZE_PX:
        raise StageError(
            f"photos have a longer side of at least {LEAST_SIZE_PX} px, got {size_px}",
            key="orchard.photo_size_px",
        )
    rng = np.random.default_rng([int(seed), 409])
    camera = CAMERAS[int(rng.integers(len(CAMERAS)))]
    if size_px:
        factor = size_px / max(camera.width, camera.height)
        camera = camera.resized(round(camera.width * factor), round(camera.height * factor))
    k1, k2 = float(rng.uniform(-0.12, 0.04)), float(rng.uniform(-0.01, 0.02))
    if not distortion:
        return camera
    return replace(camera, k1=round(k1, 4), k2=round(k2, 4))
