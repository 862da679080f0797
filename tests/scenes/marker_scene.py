"""Photos of printed markers with exactly known corners, rendered in linear light."""

import cv2
import numpy as np
import pycolmap

from cherrypicker.markers.boards import charuco_board


def pattern_of(dictionary, marker_id):
    """Cells of a marker with its border, 1 white."""
    entry = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    image = entry.generateImageMarker(marker_id, entry.markerSize + 2, borderBits=1)
    return (image > 127).astype(float)


def square(center, side, normal=(0, 0, 1), turn_deg=0.0):
    """Corners (4, 3) of a marker, clockwise as seen from where the normal points."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    right = np.cross(helper, normal)
    right /= np.linalg.norm(right)
    up = np.cross(normal, right)
    angle = np.radians(turn_deg)
    right, up = (
        np.cos(angle) * right + np.sin(angle) * up,
        np.cos(angle) * up - np.sin(angle) * right,
    )
    steps = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]) * side
    return np.asarray(center) + steps[:, :1] * right + steps[:, 1:] * up


def homography(source, destination):
    """Homography of four points onto four others, in double precision."""
    rows, values = [], []
    for (x, y), (u, v) in zip(source, destination):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        values += [u, v]
    return np.append(np.linalg.solve(rows, values), 1.0).reshape(3, 3)


def paint_marker(
    image, pattern, corners, *, camera=None, margin=1.0, dark=0.04, bright=0.85, oversampling=8
):
    """Paint a marker with its white margin into a linear image, antialiased.

    `corners` (4, 2) are undistorted normalised coordinates with a camera, else pixels.
    """
    n = np.array(pattern.shape[::-1])  # cells across and down
    inverse = homography(corners, np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * n)
    forward = np.linalg.inv(inverse)
    edge = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (n + 2 * margin) - margin
    outline = np.column_stack([edge, np.ones(4)]) @ forward.T
    outline = outline[:, :2] / outline[:, 2:]
    if camera is not None:
        outline = camera.img_from_cam(np.column_stack([outline, np.ones(4)]))
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int) - 2, 0)
    high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 3, image.shape[1::-1])
    width, height = high - low
    steps = (np.arange(oversampling) + 0.5) / oversampling
    xs = (np.arange(width)[:, None] + steps).ravel() + low[0]
    ys = (np.arange(height)[:, None] + steps).ravel() + low[1]
    pixels = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    if camera is not None:
        pixels = camera.cam_from_img(pixels)
    cells = np.column_stack([pixels, np.ones(len(pixels))]) @ inverse.T
    cells = cells[:, :2] / cells[:, 2:]
    on_paper = ((cells > -margin) & (cells < n + margin)).all(axis=1)
    in_code = ((cells >= 0) & (cells < n)).all(axis=1)
    index = np.clip(cells.astype(int), 0, n - 1)
    white = ~in_code | (pattern[index[:, 1], index[:, 0]] > 0)

    def average(values):
        blocks = values.reshape(height, oversampling, width, oversampling)
        return blocks.mean(axis=(1, 3))

    covered = average(on_paper.astype(float))
    light = average(np.where(on_paper, np.where(white, bright, dark), 0.0))
    part = image[low[1] : high[1], low[0] : high[0]]
    part[:] = part * (1 - covered) + light


def develop(image, *, blur=0.6, gamma=2.2, noise=1.0, seed=0):
    """Blur linear light, encode it and add noise: an 8-bit grey photo."""
    soft = cv2.GaussianBlur(image, (0, 0), blur) if blur > 0 else image
    encoded = 255 * np.clip(soft, 0, 1) ** (1 / gamma)
    noisy = encoded + np.random.default_rng(seed).normal(0, noise, encoded.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def background(shape, seed=0):
    """Smooth grey texture of mean 0.35."""
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(0.2, 0.5, (shape[0] // 16 + 2, shape[1] // 16 + 2))
    return cv2.resize(coarse, shape[1::-1], interpolation=cv2.INTER_CUBIC)


def charuco_pattern(values, cells=9):
    """Cells of a ChArUco board of a reference's values, `cells` a square, 1 white."""
    board = charuco_board(values)
    image = board.generateImage(tuple(cells * n for n in values["squares"]), marginSize=0)
    return (image > 127).astype(float)


def checker_pattern(cells):
    """Cells of a cube's face, 1 white."""
    return np.indices((cells, cells)).sum(axis=0) % 2.0


def rectangle(corner, across, down):
    """Corners (4, 3) of a board from its first corner and its two edges."""
    corner, across, down = (np.asarray(each, float) for each in (corner, across, down))
    return np.stack([corner, corner + across, corner + across + down, corner + down])


def marker_scan(
    folder, markers, poses_from, *, boards=(), size=(480, 360), focal=540.0, k=-0.08, gamma=2.2
):
    """Render a scan of markers and return its sparse model.

    Parameters
    ----------
    markers : list of (dictionary, id, corners (4, 3))
    boards : list of (pattern, corners (4, 3), margin in cells)
        Boards that are no markers, seen from one side, as `rectangle` gives them.
    poses_from : Poses
        Cameras, their intrinsics are replaced by a SIMPLE_RADIAL camera.
    """
    camera = pycolmap.Camera(
        camera_id=1,
        model="SIMPLE_RADIAL",
        width=size[0],
        height=size[1],
        params=[focal, size[0] / 2, size[1] / 2, k],
    )
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    photos = []
    for index, (name, matrix) in enumerate(zip(poses_from.names, poses_from.cam_from_world)):
        image = background((size[1], size[0]), seed=index)
        things = [(pattern_of(name, marker_id), at, 1.0) for name, marker_id, at in markers]
        for pattern, corners, margin in [*things, *boards]:
            inside = corners @ matrix[:, :3].T + matrix[:, 3]
            normal = np.cross(inside[1] - inside[0], inside[3] - inside[0])
            if (inside[:, 2] < 0.1).any() or inside[0] @ normal < 0:
                continue
            seen = inside[:, :2] / inside[:, 2:]
            paint_marker(image, pattern, seen, camera=camera, margin=margin, oversampling=5)
        path = folder / str(name)
        grey = develop(image, gamma=gamma, seed=index)
        cv2.imwrite(str(path), cv2.merge([grey] * 3), [cv2.IMWRITE_JPEG_QUALITY, 95])
        photos.append(path)
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=str(name), camera_id=1, image_id=index + 1),
            pycolmap.Rigid3d(matrix),
        )
    return photos, model
