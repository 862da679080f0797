"""Render an orchard scene with Blender's Python module bpy: colours, and exact maps of the truth.

Only this module needs bpy, and only once a photo is rendered; bpy is an optional extra with an
environment of its own (envs/requirements-render.txt).
"""

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker_lab.orchard.render.materials import (
    LIGHT,
    PACK,
    SWITCH,
    TRUTH,
    ground_colors,
    image_colors,
    new_material,
    vertex_colors,
)
from cherrypicker_lab.orchard.render.photo import BACKGROUND_ID, decode_srgb
from cherrypicker_lab.orchard.render.wind import moved_points, sway
from cherrypicker_lab.orchard.scene.appearance import bark_relief, encode_srgb, surface_color
from cherrypicker_lab.orchard.scene.ground import bake_ground
from cherrypicker_lab.orchard.scene.mesh import NO_TREE, ground_disc

INSTALL = (
    "python3.11 -m venv .venv-render && .venv-render/bin/pip install -r "
    "envs/requirements-render.txt && .venv-render/bin/pip install --no-deps "
    "opencv-contrib-python-headless==5.0.0.93"
)
# the ground's textures: half width (of the cameras' distance) and pixel (of a photo's at the tree)
GROUND_TEXTURES = ((1.25, 1.0), (3.5, 3.0))
HORIZON_M, HORIZON_PIXEL_M = 40.0, 0.08
HILL_PIXEL_M = 0.025  # slopes face the camera: a pixel of a photo at 20 m
DENSE_KINDS = ("leaves", "bark")  # their vertices carry the colours as they are
LEAST_DISTANCE_M = 2.0


def import_bpy():
    """Blender's module, or a `StageError` that says how to get it if it is not installed."""
    try:
        import bpy
    except ImportError as error:
        raise StageError(
            f"rendering needs Blender's module bpy in an environment of its own: {INSTALL}",
            key="orchard.blender_python",
        ) from error
    return bpy


def load_image(bpy, folder, name, pixels):
    """Hand an sRGB image (H, W, 3) uint8 to Blender by way of a file."""
    path = str(Path(folder) / f"{name}.png")
    Image.fromarray(pixels).save(path, compress_level=1)
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "sRGB"
    return image


def add_mesh(bpy, name, mesh, materials, *, face_material=None, **attributes):
    """Add a mesh object with vertex attributes of three components."""
    data = bpy.data.meshes.new(name)
    n_faces = len(mesh.faces)
    data.vertices.add(len(mesh.vertices))
    data.vertices.foreach_set("co", mesh.vertices.astype(np.float32).ravel())
    data.loops.add(3 * n_faces)
    data.loops.foreach_set("vertex_index", mesh.faces.astype(np.int32).ravel())
    data.polygons.add(n_faces)
    data.polygons.foreach_set("loop_start", np.arange(0, 3 * n_faces, 3, dtype=np.int32))
    if face_material is not None:
        data.polygons.foreach_set("material_index", face_material.astype(np.int32))
    for key, values in attributes.items():
        layer = data.attributes.new(key, "FLOAT_VECTOR", "POINT")
        layer.data.foreach_set("vector", values.astype(np.float32).ravel())
    for material in materials:
        data.materials.append(material)
    data.update(calc_edges=True)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, data))
    return data


def subdivided(mesh, times):
    """Split every triangle into four, `times` over, so that vertex colours carry texture."""
    for _ in range(times):
        v, f = mesh.vertices, mesh.faces
        triangle = v[f]
        middle = 0.5 * (triangle + np.roll(triangle, -1, axis=1))
        attributes = {}
        for key, values in mesh.attributes.items():
            corner = values[f]
            attributes[key] = np.concatenate([corner, 0.5 * (corner + np.roll(corner, -1, 1))], 1)
            attributes[key] = attributes[key].reshape(-1, *values.shape[1:])
        vertices = np.concatenate([triangle, middle], axis=1).reshape(-1, 3)
        first = 6 * np.arange(len(f))[:, None, None]
        quarter = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
        mesh = type(mesh)(vertices, (first + quarter).reshape(-1, 3).astype(np.int32), attributes)
    return mesh


def truth_attribute(labels, tree):
    """Vertex attribute that carries class and tree into the maps, (n, 3) float64."""
    labels = np.where(np.asarray(labels) == Label.UNLABELLED, BACKGROUND_ID, labels)
    return np.column_stack([labels, np.full(len(labels), min(tree, 16)), np.zeros(len(labels))])


def add_trees(bpy, scene, painted):
    """Trees with the relief of their bark; per tree the mesh in Blender and our own."""
    made = []
    for tree in scene.tree_objects(row_step=0.002, side_step=0.002, max_sides=160):
        mesh, at = tree.mesh, tree.mesh.attributes
        albedo = surface_color(tree.material, at, len(mesh.vertices))
        if tree.material["relief"] > 0:
            height = bark_relief(at["rest"], at["radius"], tree.material)
            mesh = mesh.moved(height[:, None] * mesh.vertex_normals())
        truth = truth_attribute(scene.trees[tree.tree].labels[at["axis"]], tree.tree)
        data = add_mesh(bpy, tree.name, mesh, [painted], albedo=albedo, truth=truth)
        data.polygons.foreach_set("use_smooth", np.ones(len(data.polygons), bool))
        made.append((data, mesh))
    return made


def add_things(bpy, scene, folder, painted):
    """All that is neither a tree nor the ground, the background too."""
    for thing in [*scene.objects, *scene.surroundings]:
        if thing.material["kind"] == "image":
            pixels = np.round(255 * encode_srgb(thing.material["image"])).astype(np.uint8)
            image = load_image(bpy, folder, thing.name, pixels)
            filtering = {"closest": "Closest", "linear": "Linear"}[thing.material["filter"]]
            material = new_material(bpy, thing.name, scene.light, image_colors(image, filtering))
            uv = np.clip(thing.mesh.attributes["uv"], 0, 1)
            uv = np.column_stack([uv, np.zeros(len(uv))])
            truth = truth_attribute(np.full(len(uv), thing.label), NO_TREE)
            add_mesh(bpy, thing.name, thing.mesh, [material], uv3=uv, truth=truth)
        else:
            times = 3 if len(thing.mesh.faces) < 5000 else 2
            times = 0 if thing.material["kind"] in DENSE_KINDS else times
            fine = subdivided(thing.mesh, times)
            albedo = surface_color(thing.material, fine.attributes, len(fine.vertices))
            truth = truth_attribute(np.full(len(albedo), thing.label), NO_TREE)
            add_mesh(bpy, thing.name, fine, [painted], albedo=albedo, truth=truth)


def ground_textures(distance, focal_px, horizon_pixel=HORIZON_PIXEL_M):
    """Half widths (m) and sizes (px) of the ground's textures, from the finest to the horizon's.

    `distance` is that of the cameras from the tree, `horizon_pixel` the coarsest texture's pixel,
    m.
    """
    distance = max(distance, LEAST_DISTANCE_M)
    made = []
    for reach, pixels in GROUND_TEXTURES:
        half = min(reach * distance, 0.8 * HORIZON_M)
        made.append((half, int(np.ceil(2 * half / (pixels * distance / focal_px)))))
    return [*made, (HORIZON_M, int(2 * HORIZON_M / horizon_pixel))]


def add_ground(bpy, scene, folder, textures):
    """The ground disc with a fine texture near the tree and coarser ones beyond."""
    mesh = ground_disc(scene.ground_height, outer=HORIZON_M, rings=420, sectors=360)
    middle = mesh.vertices[mesh.faces].mean(1)
    reach = [half - 0.1 for half, _ in textures[:-1]]
    zone = np.searchsorted(reach, np.hypot(middle[:, 0], middle[:, 1]))
    materials = []
    for number, (half, size) in enumerate(textures):
        pixels = bake_ground(scene.ground_seed, half, size, scene.ground_kind)
        image = load_image(bpy, folder, f"ground_{number}", pixels)
        colors = ground_colors(image, half)
        materials.append(new_material(bpy, f"ground_{number}", scene.light, colors))
    truth = truth_attribute(np.full(len(mesh.vertices), int(Label.GROUND)), NO_TREE)
    data = add_mesh(bpy, "ground", mesh, materials, face_material=zone, truth=truth)
    data.polygons.foreach_set("use_smooth", np.ones(len(data.polygons), bool))


def set_up(bpy, scene, camera, samples, threads):
    """Renderer, sun and camera; returns the camera object."""
    render = bpy.context.scene.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = camera.width, camera.height
    render.resolution_percentage = 100
    render.film_transparent = True
    render.use_persistent_data = True
    render.threads_mode, render.threads = "FIXED", threads
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGBA"
    render.image_settings.compression = 0
    view = bpy.context.scene.view_settings
    view.view_transform, view.look = "Standard", "None"
    cycles = bpy.context.scene.cycles
    cycles.device, cycles.samples = "CPU", samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.max_bounces = cycles.diffuse_bounces = 0
    cycles.seed = scene.seed % 1000

    lamp = bpy.data.lights.new("sun", "SUN")
    strength = float(scene.light.sun.max())
    lamp.energy, lamp.angle = np.pi * strength, 0.0
    lamp.color = scene.light.sun / strength
    sun = bpy.data.objects.new("sun", lamp)
    sun.rotation_mode = "QUATERNION"
    from mathutils import Vector  # comes with bpy

    sun.rotation_quaternion = Vector(scene.light.sun_direction).to_track_quat("Z", "Y")
    bpy.context.scene.collection.objects.link(sun)

    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", 36.0
    lens.lens = camera.focal_px * 36.0 / camera.width
    lens.clip_start, lens.clip_end = 0.05, 200.0
    eye = bpy.data.objects.new("camera", lens)
    bpy.context.scene.collection.objects.link(eye)
    bpy.context.scene.camera = eye
    return eye


def place(eye, cam_from_world):
    """Set Blender's camera (x right, y up, z backward) to one of our poses."""
    from mathutils import Matrix  # comes with bpy

    rotation = cam_from_world[:, :3].T @ np.diag([1.0, -1.0, -1.0])
    center = -cam_from_world[:, :3].T @ cam_from_world[:, 3]
    eye.matrix_world = Matrix(np.vstack([np.column_stack([rotation, center]), [0, 0, 0, 1]]))


def unpack_truth(pixels):
    """Split rendered truth (h, w, 4), rows from the top, into maps; see `materials.truth_light`.

    Returns depth (h, w) float32, m along the optical axis, and normals (h, w, 3) float32 in the
    camera's frame (x right, y down, z forward), both 0 where nothing is; then label and tree, (h,
    w) uint8, 255 where nothing is, and `tree` also where no tree is.
    """
    there = pixels[..., 3] > 0.5
    depth = np.where(there, pixels[..., 0], 0).astype(np.float32)
    kind = np.clip(np.round((pixels[..., 1:3] - 2.0) / PACK), 0, 255)
    x, y = np.moveaxis(pixels[..., 1:3] - 2.0 - PACK * kind, -1, 0)
    x, y = np.clip(x, -1, 1), np.clip(-y, -1, 1)  # Blender's camera has y up
    z = -np.sqrt(np.clip(1.0 - x**2 - y**2, 0, 1))
    normals = np.where(there[..., None], np.stack([x, y, z], -1), 0).astype(np.float32)
    label = np.where(there, kind[..., 0], 255).astype(np.uint8)
    tree = np.where(there & (kind[..., 1] < 16), kind[..., 1], NO_TREE).astype(np.uint8)
    return depth, normals, label, tree


class BlenderScene:
    """A scene built in Blender, to be rendered photo by photo. Use it as a context manager.

    The cameras' `distance` from the tree, m, says how fine the ground's textures are; `samples` are
    Cycles' a pixel.
    """

    def __init__(self, scene, camera, *, distance=2.5, samples=4, threads=2):
        self.bpy = import_bpy()
        self.bpy.ops.wm.read_factory_settings(use_empty=True)
        self._folder = tempfile.TemporaryDirectory()
        self.samples = samples
        self.eye = set_up(self.bpy, scene, camera, samples, threads)
        painted = new_material(self.bpy, "painted", scene.light, vertex_colors)
        self._scene, self._trees = scene, add_trees(self.bpy, scene, painted)
        add_things(self.bpy, scene, self._folder.name, painted)
        horizon_pixel = HILL_PIXEL_M if scene.background == "hills" else HORIZON_PIXEL_M
        textures = ground_textures(distance, camera.focal_px, horizon_pixel)
        add_ground(self.bpy, scene, self._folder.name, textures)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._folder.cleanup()

    def _render(self, name, file_format, depth):
        settings = self.bpy.context.scene.render
        path = Path(self._folder.name) / name
        settings.image_settings.file_format = file_format
        settings.image_settings.color_mode = "RGBA"
        settings.image_settings.color_depth = depth
        settings.filepath = str(path)
        self.bpy.ops.render.render(write_still=True)
        return path

    def _prepare(self, is_truth):
        """Switch between light and truth."""
        cycles = self.bpy.context.scene.cycles
        for material in self.bpy.data.materials:
            switch = material.node_tree.nodes[SWITCH]
            switch.outputs[0].default_value = TRUTH if is_truth else LIGHT
        cycles.samples = 1 if is_truth else self.samples
        cycles.pixel_filter_type = "BOX" if is_truth else "BLACKMAN_HARRIS"
        cycles.filter_width = 0.01 if is_truth else 1.5

    def blow(self, photo):
        """Bend the trees as the wind does in a photo, see `wind.sway`."""
        scene = self._scene
        for tree, (data, mesh) in zip(scene.trees, self._trees):
            moved = moved_points(
                tree, sway(tree, scene.wind_m, scene.seed, photo), mesh.attributes["axis"],
                mesh.attributes["s"],
            )  # fmt: skip
            data.vertices.foreach_set("co", (mesh.vertices + moved).astype(np.float32).ravel())
            data.update()

    def colors(self, cam_from_world):
        """Linear colours (h, w, 3) float64 and cover (h, w) of all surfaces in a photo."""
        self._prepare(False)
        place(self.eye, cam_from_world)
        rendered = np.asarray(Image.open(self._render("color.png", "PNG", "8")).convert("RGBA"))
        return decode_srgb(rendered[..., :3] / 255.0), rendered[..., 3] / 255.0

    def truth(self, cam_from_world):
        """Depth, normals, label and tree at the centre of each pixel, see `unpack_truth`."""
        self._prepare(True)
        place(self.eye, cam_from_world)
        path = self._render("truth.exr", "OPEN_EXR", "32")
        image = self.bpy.data.images.load(str(path))
        image.colorspace_settings.name = "Non-Color"
        image.alpha_mode = "CHANNEL_PACKED"
        width, height = image.size
        pixels = np.empty(4 * width * height, np.float32)
        image.pixels.foreach_get(pixels)
        self.bpy.data.images.remove(image)
        return unpack_truth(pixels.reshape(height, width, 4)[::-1])
