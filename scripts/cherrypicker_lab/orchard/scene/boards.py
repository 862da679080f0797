"""Things that people put into a scan: marker boards, signs, calibration ring and checker cube."""

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.scene.mesh import (
    SceneObject,
    box,
    cylinder,
    quad_board,
    ring,
    turn_about,
)

WHITE, BLACK = 0.58, 0.025
MARGIN_MODULES = 1.5
GROUND_CLEARANCE_M = 0.03


def marker_image(dictionary, marker_id, margin_modules=MARGIN_MODULES):
    """Print a marker of an id of a dictionary, such as "DICT_4X4_50", with its white margin.

    The margin counts modules, a multiple of 0.5. Returns linear albedo (n, n, 3), two texels a
    module, and the number of modules along the marker's side, black border included. Raises a
    ValueError if OpenCV has no such dictionary or the dictionary no such id.
    """
    code = getattr(cv2.aruco, dictionary, None)
    if code is None:
        raise ValueError(f"OpenCV has no marker dictionary {dictionary!r}")
    book = cv2.aruco.getPredefinedDictionary(code)
    if not 0 <= marker_id < len(book.bytesList):
        raise ValueError(f"{dictionary} has ids 0 to {len(book.bytesList) - 1}, got {marker_id}")
    n = book.markerSize + 2
    bits = cv2.aruco.generateImageMarker(book, int(marker_id), n) > 127
    pad = int(round(2 * margin_modules))
    texels = np.pad(np.kron(bits, np.ones((2, 2), bool)), pad, constant_values=True)
    return np.where(texels[..., None], WHITE, BLACK) * np.ones(3), n


def board_turn(azimuth, elevation):
    """Rotation of a board from the x-y plane: its y leans to `azimuth`, raised by `elevation`.

    elevation 0 leaves it lying face up with its top towards the azimuth; pi/2 stands it upright,
    facing away from the azimuth.
    """
    c, s = np.cos(azimuth), np.sin(azimuth)
    ce, se = np.cos(elevation), np.sin(elevation)
    y = np.array([c * ce, s * ce, se])
    x = np.array([s, -c, 0.0])
    return np.stack([x, y, np.cross(x, y)], axis=1)


def marker_object(spec, xy, ground_z, seed):
    """Place a marker board at xy (2,), m, on the ground, and return its objects and its truth.

    `spec` has `dictionary`, `id`, `side_m`, `pose` ("lying", "standing" or "post": standing on a
    stake of a man's chest), `azimuth` and `tilt` (rad). The truth has `dictionary`, `id`, `side_m`,
    and `corners` (4, 3) in OpenCV's order.
    """
    image, n = marker_image(spec["dictionary"], spec["id"])
    side = float(spec["side_m"])
    edge = side * (n + 2 * MARGIN_MODULES) / n
    is_up = spec["pose"] in ("standing", "post")
    if is_up:
        elevation = np.pi / 2 - 0.12
        lift = 1.1 if spec["pose"] == "post" else 0.25
        centre = np.array([*xy, ground_z + edge * 0.62 + lift])
    else:
        elevation = spec["tilt"]
        lift = np.sin(elevation) * edge / 2 + GROUND_CLEARANCE_M
        centre = np.array([*xy, ground_z + lift])
    rotation = board_turn(spec["azimuth"], elevation)
    material = {"kind": "image", "image": image, "filter": "closest"}
    name = f"marker_{spec['id']}"
    board = quad_board(edge, edge, 0.008).moved(centre, rotation)
    objects = [SceneObject(name, int(Label.MARKER), board, material)]
    if is_up:
        wood = {"kind": "wood", "seed": seed + 3, "color": (0.40, 0.31, 0.20)}
        foot = centre - 0.02 * rotation[:, 2]
        stick = cylinder((foot[0], foot[1], ground_z - 0.05), foot, 0.014, sides=12)
        objects.append(SceneObject(f"{name}_stick", int(Label.MARKER), stick, wood))
    half = side / 2
    corners = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    truth = {k: spec[k] for k in ("dictionary", "id", "side_m")}
    truth["corners"] = (corners @ rotation.T + centre).tolist()
    return objects, truth


def _sign_image(rng):
    """A plate with two lines of text."""
    ground = np.array([[0.55, 0.55, 0.50], [0.55, 0.45, 0.08], [0.10, 0.30, 0.14]])[rng.integers(3)]
    ink = (20, 20, 20) if ground.sum() > 0.8 else (235, 235, 235)
    plate = Image.new("RGB", (300, 200), tuple(int(255 * c**0.45) for c in ground))
    draw = ImageDraw.Draw(plate)
    draw.rectangle((6, 6, 293, 193), outline=ink, width=4)
    variety = rng.choice(["Kordia", "Regina", "Lapins", "Summit", "Bellise", "Sylvia"])
    draw.text((24, 24), str(variety), fill=ink, font=ImageFont.load_default(62))
    text = f"row {rng.integers(1, 30)} tree {rng.integers(1, 99)}"
    draw.text((24, 120), text, fill=ink, font=ImageFont.load_default(40))
    return (np.asarray(plate) / 255.0) ** 2.2 * 0.85


def board_on_post(rng, seed, spec, azimuth, ground_z):
    """A sign on a short post, readable from outside; a list of two objects of class sign.

    `spec` has `xy`, and may have `width` and `top` (height of the plate's middle), all m.
    """
    drawn_width, shape, drawn_top = rng.uniform([0.18, 0.6, 0.35], [0.42, 0.75, 0.9])
    width, top = spec.get("width", drawn_width), spec.get("top", drawn_top)
    height = width * shape
    rotation = board_turn(azimuth + np.pi + rng.normal() * 0.3, np.pi / 2 - rng.uniform(0, 0.3))
    centre = np.array([*spec["xy"], ground_z + top])
    plate = quad_board(width, height, 0.006).moved(centre, rotation)
    foot = centre - 0.018 * rotation[:, 2]
    post = cylinder((foot[0], foot[1], ground_z - 0.05), foot, 0.013, sides=12)
    image = {"kind": "image", "image": _sign_image(rng), "filter": "linear"}
    wood = {"kind": "wood", "seed": seed + 4, "color": (0.34, 0.28, 0.21)}
    return [
        SceneObject("sign", int(Label.SIGN), plate, image),
        SceneObject("sign_post", int(Label.SIGN), post, wood),
    ]


def checker_cube(rng, seed, xy, ground_z):
    """A cube with a black and white checker pattern on every face."""
    edge, cells = rng.uniform(0.10, 0.20), int(rng.integers(3, 6))
    turn = turn_about(rng.uniform(0, np.pi / 2))
    board = np.indices((cells, cells)).sum(0) % 2 == 0
    image = np.where(board[..., None], WHITE, BLACK) * np.ones(3)
    mesh = box((edge, edge, edge)).moved((*xy, ground_z + edge / 2 + 0.005), turn)
    material = {"kind": "image", "image": image, "filter": "closest"}
    return SceneObject("checker_cube", int(Label.CALIBRATION_UNIT), mesh, material)


def stem_ring(rng, seed, stem):
    """A white sleeve around the stem, 3 to 6 cm wide, clear of the height of the stem diameter.

    Lower and narrower on a stem that forks close to the ground.
    """
    length = stem.arclength[-1]
    middle = min(rng.uniform(0.38, 0.55), 0.8 * length)
    at = middle + min(rng.uniform(0.03, 0.06), 0.4 * length) * np.linspace(-0.5, 0.5, 7)
    points, reach = stem.at(at)
    material = {"kind": "plain", "seed": seed + 6, "color": (WHITE, WHITE, 0.95 * WHITE)}
    return SceneObject("ring", int(Label.CALIBRATION_UNIT), ring(points, reach + 0.004), material)
