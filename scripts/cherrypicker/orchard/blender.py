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
from cherrypicker.orchard.appearance import encode_srgb, ground_color, surface_color
from cherrypicker.orchard.mesh import NO_TREE, ground_disc
from cherrypicker.orchard.photo import decode_srgb

__all__ = ["INSTALL", "BlenderScene"]

INSTALL = (
    "python3.11 -m venv .venv-render && .venv-render/bin/pip install -r "
    "envs/requirements-render.txt && .venv-render/bin/pip install --no-deps "
    "opencv-contrib-python-headless==5.0.0.93"
)
# half width (m) and pixels of the ground's textures: 2 mm a pixel at the tree, coarser far off
GROUND_TEXTURES = ((4.1, 4096), (12.0, 3072), (40.0, 2048))
_SWITCH, _LIGHT, _TRUTH = "switch", -1e6, 1e6
_PACK = 4.0  # a label is packed above a normal's component, which lies in [-1, 1]


def import_bpy():
    """Blender's module, or an error that says how to get it.

    Raises
    ------
    StageError
        If it is not installed.
    """
    try:
        import bpy
    except ImportError as error:
        raise StageError(
            f"rendering needs Blender's module bpy in an environment of its own: {INSTALL}",
            key="orchard.blender_python",
        ) from error
    return bpy


def new_material(bpy, name, light, color_socket):
    """A diffuse surface lit by the sun lamp, plus the sky's light by how far it faces up.

    `color_socket(nodes, links)` builds the albedo and returns its output socket. The material's
    switch turns the light into the truth, see `truth_light`: a change of a value, after which
    Cycles need not read the meshes anew.
    """
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender 5 makes it at once
        material.use_nodes = True
    # the sky's share is written as emission, but no surface is a lamp to draw shadow rays to
    material.cycles.emission_sampling = "NONE"
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    albedo = color_socket(nodes, links)
    normal = nodes.new("ShaderNodeNewGeometry").outputs["Normal"]
    axis = nodes.new("ShaderNodeSeparateXYZ")
    links.new(normal, axis.inputs[0])
    up = nodes.new("ShaderNodeMapRange")
    up.inputs["From Min"].default_value = -1.0
    links.new(axis.outputs["Z"], up.inputs["Value"])
    ambient = nodes.new("ShaderNodeMix")
    ambient.data_type = "RGBA"
    links.new(up.outputs["Result"], ambient.inputs["Factor"])
    sockets = [s for s in ambient.inputs if s.type == "RGBA"]
    sockets[0].default_value = (*light.ambient_bottom, 1.0)
    sockets[1].default_value = (*light.ambient_top, 1.0)
    product = nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    links.new(albedo, product.inputs[0])
    links.new(next(s for s in ambient.outputs if s.type == "RGBA"), product.inputs[1])
    emission = nodes.new("ShaderNodeEmission")
    links.new(product.outputs[0], emission.inputs["Color"])
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    links.new(albedo, diffuse.inputs["Color"])
    total = nodes.new("ShaderNodeAddShader")
    links.new(emission.outputs[0], total.inputs[0])
    links.new(diffuse.outputs[0], total.inputs[1])
    either = nodes.new("ShaderNodeMixShader")
    links.new(_switch(nodes, links), either.inputs[0])
    links.new(total.outputs[0], either.inputs[1])
    links.new(truth_light(nodes, links), either.inputs[2])
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(either.outputs[0], output.inputs["Surface"])
    return material


def _switch(nodes, links):
    """A socket of 0 (light) or 1 (truth) after the value node named `_SWITCH`.

    The depth is added so that the sum is not known before a ray hits: else Cycles would leave the
    other half of the material out, and read all meshes again at each turn of the switch.
    """
    value = nodes.new("ShaderNodeValue")
    value.name = _SWITCH
    value.outputs[0].default_value = _LIGHT
    total = nodes.new("ShaderNodeMath")
    total.operation = "ADD"
    links.new(nodes.new("ShaderNodeCameraData").outputs["View Z Depth"], total.inputs[0])
    links.new(value.outputs[0], total.inputs[1])
    above = nodes.new("ShaderNodeMath")
    above.operation = "GREATER_THAN"
    above.inputs[1].default_value = 0.0
    links.new(total.outputs[0], above.inputs[0])
    return above.outputs[0]


def truth_light(nodes, links):
    """Light that is the truth: red depth, green and blue normals with class and tree.

    Depth lies along the optical axis, m. Green is the normal's x in the camera plus 2 plus four
    times the class, blue its y plus 2 plus four times the tree. The normal's z follows, since a
    surface that is seen faces the camera.
    """
    depth = nodes.new("ShaderNodeCameraData").outputs["View Z Depth"]
    turn = nodes.new("ShaderNodeVectorTransform")
    turn.vector_type, turn.convert_from, turn.convert_to = "NORMAL", "WORLD", "CAMERA"
    links.new(nodes.new("ShaderNodeNewGeometry").outputs["True Normal"], turn.inputs[0])
    normal = nodes.new("ShaderNodeSeparateXYZ")
    links.new(turn.outputs[0], normal.inputs[0])
    attribute = nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "truth"
    kinds = nodes.new("ShaderNodeSeparateXYZ")
    links.new(attribute.outputs["Vector"], kinds.inputs[0])
    color = nodes.new("ShaderNodeCombineXYZ")
    links.new(depth, color.inputs[0])
    for k, axis in ((1, "X"), (2, "Y")):
        packed = nodes.new("ShaderNodeMath")
        packed.operation = "MULTIPLY_ADD"
        links.new(kinds.outputs["XY"[k - 1]], packed.inputs[0])
        packed.inputs[1].default_value = _PACK
        links.new(normal.outputs[axis], packed.inputs[2])
        above = nodes.new("ShaderNodeMath")  # light is never negative
        above.operation = "ADD"
        above.inputs[1].default_value = 2.0
        links.new(packed.outputs[0], above.inputs[0])
        links.new(above.outputs[0], color.inputs[k])
    emission = nodes.new("ShaderNodeEmission")
    links.new(color.outputs[0], emission.inputs["Color"])
    return emission.outputs[0]


def vertex_colors(nodes, _links):
    """Albedo from the mesh's colour attribute."""
    attribute = nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "albedo"
    return attribute.outputs["Color"]


def image_colors(image, interpolation):
    """Albedo from an image by the mesh's uv."""

    def build(nodes, links):
        attribute = nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = "uv3"
        texture = nodes.new("ShaderNodeTexImage")
        texture.image, texture.interpolation, texture.extension = image, interpolation, "EXTEND"
        links.new(attribute.outputs["Vector"], texture.inputs["Vector"])
        return texture.outputs["Color"]

    return build


def ground_colors(image, half):
    """Albedo from an image that spans [-half, half] metres in x and y."""

    def build(nodes, links):
        position = nodes.new("ShaderNodeNewGeometry").outputs["Position"]
        mapping = nodes.new("ShaderNodeMapping")
        mapping.inputs["Scale"].default_value = (0.5 / half, 0.5 / half, 0.0)
        mapping.inputs["Location"].default_value = (0.5, 0.5, 0.0)
        links.new(position, mapping.inputs["Vector"])
        texture = nodes.new("ShaderNodeTexImage")
        texture.image, texture.interpolation, texture.extension = image, "Linear", "EXTEND"
        links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
        return texture.outputs["Color"]

    return build


def load_image(bpy, folder, name, linear):
    """Hand a linear albedo image (H, W, 3) to Blender by way of an 8-bit file."""
    path = str(Path(folder) / f"{name}.png")
    Image.fromarray(np.round(255 * encode_srgb(linear)).astype(np.uint8)).save(
        path, compress_level=1
    )
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "sRGB"
    return image


def bake_ground(seed, half, size):
    """Ground albedo over a square of half width `half` m as an image (size, size, 3), float32."""
    axis = (np.arange(size) + 0.5) / size * 2 * half - half
    image = np.empty((size, size, 3), np.float32)
    rows = max(1, 2_000_000 // size)
    for start in range(0, size, rows):
        y = -axis[start : start + rows]
        xy = np.stack(np.meshgrid(axis, y), axis=-1).reshape(-1, 2)
        image[start : start + rows] = ground_color(xy, seed).reshape(len(y), size, 3)
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
    return np.column_stack([labels, np.full(len(labels), min(tree, 16)), np.zeros(len(labels))])


def add_things(bpy, scene, folder):
    """Trees and the other objects."""
    painted = new_material(bpy, "painted", scene.light, vertex_colors)
    for tree in scene.tree_objects(row_step=0.002, side_step=0.002, max_sides=160):
        albedo = surface_color(tree.material, tree.mesh.attributes, len(tree.mesh.vertices))
        labels = np.array([int(a.label) for a in scene.trees[tree.tree].axes])
        truth = truth_attribute(labels[tree.mesh.attributes["axis"]], tree.tree)
        data = add_mesh(bpy, tree.name, tree.mesh, [painted], albedo=albedo, truth=truth)
        data.polygons.foreach_set("use_smooth", np.ones(len(data.polygons), bool))
    for thing in scene.objects:
        if thing.material["kind"] == "image":
            image = load_image(bpy, folder, thing.name, thing.material["image"])
            filtering = {"closest": "Closest", "linear": "Linear"}[thing.material["filter"]]
            material = new_material(bpy, thing.name, scene.light, image_colors(image, filtering))
            uv = np.clip(thing.mesh.attributes["uv"], 0, 1)
            uv = np.column_stack([uv, np.zeros(len(uv))])
            truth = truth_attribute(np.full(len(uv), thing.label), NO_TREE)
            add_mesh(bpy, thing.name, thing.mesh, [material], uv3=uv, truth=truth)
        else:
            fine = subdivided(thing.mesh, 3 if len(thing.mesh.faces) < 5000 else 2)
            albedo = surface_color(thing.material, fine.attributes, len(fine.vertices))
            truth = truth_attribute(np.full(len(albedo), thing.label), NO_TREE)
            add_mesh(bpy, thing.name, fine, [painted], albedo=albedo, truth=truth)


def add_ground(bpy, scene, folder):
    """The ground disc with a fine texture near the tree and coarser ones beyond."""
    outer = GROUND_TEXTURES[-1][0]
    mesh = ground_disc(scene.ground_height, outer=outer, rings=420, sectors=360)
    middle = mesh.vertices[mesh.faces].mean(1)
    reach = [half - 0.1 for half, _ in GROUND_TEXTURES[:-1]]
    zone = np.searchsorted(reach, np.hypot(middle[:, 0], middle[:, 1]))
    materials = []
    for half, size in GROUND_TEXTURES:
        linear = bake_ground(scene.ground_seed, half, size)
        image = load_image(bpy, folder, f"ground_{half:.0f}", linear)
        colors = ground_colors(image, half)
        materials.append(new_material(bpy, f"ground_{half:.0f}", scene.light, colors))
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
    """Split rendered truth (h, w, 4), rows from the top, into maps; see `truth_light`.

    Returns
    -------
    depth : ndarray of shape (h, w), float32
        m along the optical axis, 0 where nothing is.
    normals : ndarray of shape (h, w, 3), float32
        Camera's frame (x right, y down, z forward), 0 where nothing is.
    label, tree : ndarray of shape (h, w), uint8
        255 where nothing is; `tree` also where no tree is.
    """
    there = pixels[..., 3] > 0.5
    depth = np.where(there, pixels[..., 0], 0).astype(np.float32)
    kind = np.clip(np.round((pixels[..., 1:3] - 2.0) / _PACK), 0, 255)
    x, y = np.moveaxis(pixels[..., 1:3] - 2.0 - _PACK * kind, -1, 0)
    x, y = np.clip(x, -1, 1), np.clip(-y, -1, 1)  # Blender's camera has y up
    z = -np.sqrt(np.clip(1.0 - x**2 - y**2, 0, 1))
    normals = np.where(there[..., None], np.stack([x, y, z], -1), 0).astype(np.float32)
    label = np.where(there, kind[..., 0], 255).astype(np.uint8)
    tree = np.where(there & (kind[..., 1] < 16), kind[..., 1], NO_TREE).astype(np.uint8)
    return depth, normals, label, tree


class BlenderScene:
    """A scene built in Blender, to be rendered photo by photo. Use it as a context manager.

    Parameters
    ----------
    scene : cherrypicker.orchard.scene.Scene
    camera : CameraModel
    samples : int
        Cycles' samples a pixel.
    threads : int
    """

    def __init__(self, scene, camera, *, samples=4, threads=2):
        self.bpy = import_bpy()
        self.bpy.ops.wm.read_factory_settings(use_empty=True)
        self._folder = tempfile.TemporaryDirectory()
        self.samples = samples
        self.eye = set_up(self.bpy, scene, camera, samples, threads)
        add_things(self.bpy, scene, self._folder.name)
        add_ground(self.bpy, scene, self._folder.name)

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
            switch = material.node_tree.nodes[_SWITCH]
            switch.outputs[0].default_value = _TRUTH if is_truth else _LIGHT
        cycles.samples = 1 if is_truth else self.samples
        cycles.pixel_filter_type = "BOX" if is_truth else "BLACKMAN_HARRIS"
        cycles.filter_width = 0.01 if is_truth else 1.5

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
