"""Render an orchard scene with Blender: photos with EXIF and their exact ground truth.

Writes FOLDER/photos/*.jpg and FOLDER/truth/ (poses.npz, skeleton.csv, cloud.ply, traits.json,
scene.json). Photos that are there already are kept, so a killed run goes on where it was.
Needs an environment of its own with Blender's Python module, which nothing else uses (see
envs/requirements-render.txt). The two shipped demo scans were made by

    python scripts/render_scene.py --preset cherry_leader --output resources/demo/cherry_leader
    python scripts/render_scene.py --preset cherry_vase --output resources/demo/cherry_vase

and any other scene, a random one of a seed, by

    python scripts/render_scene.py --seed 17 --output /data/orchard/17
"""

import argparse
import io
import logging
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

sys.path.insert(0, str(Path(__file__).resolve().parent))

from cherrypicker.files import atomic_path
from cherrypicker.orchard import generate_scene
from cherrypicker.orchard.appearance import encode_srgb, ground_color, surface_color
from cherrypicker.orchard.backdrop import backdrop
from cherrypicker.orchard.cameras import CameraModel, Ring, ring_poses
from cherrypicker.orchard.mesh import ground_disc
from cherrypicker.orchard.presets import PRESETS
from cherrypicker.orchard.truth import write_truth

logger = logging.getLogger("render_scene")

# half width (m) and pixels of the ground's textures: 2 mm a pixel at the tree, coarser far off
GROUND_TEXTURES = ((4.1, 4096), (12.0, 3072), (40.0, 2048))


def new_material(bpy, name, light, color_socket):
    """A diffuse surface lit by the sun lamp, plus the sky's light by how far it faces up.

    `color_socket(nodes, links)` builds the albedo and returns its output socket.
    """
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender 5 makes it at once
        material.use_nodes = True
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
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(total.outputs[0], output.inputs["Surface"])
    return material


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


def add_things(bpy, scene, folder):
    """Trees and the other objects."""
    painted = new_material(bpy, "painted", scene.light, vertex_colors)
    for tree in scene.tree_objects(row_step=0.002, side_step=0.002, max_sides=160):
        albedo = surface_color(tree.material, tree.mesh.attributes, len(tree.mesh.vertices))
        data = add_mesh(bpy, tree.name, tree.mesh, [painted], albedo=albedo)
        data.polygons.foreach_set("use_smooth", np.ones(len(data.polygons), bool))
    for thing in scene.objects:
        if thing.material["kind"] == "image":
            image = load_image(bpy, folder, thing.name, thing.material["image"])
            filtering = {"closest": "Closest", "linear": "Linear"}[thing.material["filter"]]
            material = new_material(bpy, thing.name, scene.light, image_colors(image, filtering))
            uv = np.clip(thing.mesh.attributes["uv"], 0, 1)
            uv = np.column_stack([uv, np.zeros(len(uv))])
            add_mesh(bpy, thing.name, thing.mesh, [material], uv3=uv)
        else:
            fine = subdivided(thing.mesh, 3 if len(thing.mesh.faces) < 5000 else 2)
            albedo = surface_color(thing.material, fine.attributes, len(fine.vertices))
            add_mesh(bpy, thing.name, fine, [painted], albedo=albedo)


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
    data = add_mesh(bpy, "ground", mesh, materials, face_material=zone)
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


def pixel_rays(K, cam_from_world, width, height):
    """Unit viewing directions of all pixels, shape (height * width, 3)."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel(), np.ones(width * height)])
    rays = (cam_from_world[:, :3].T @ np.linalg.inv(K) @ pixels).T
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def decode_srgb(encoded):
    """sRGB in [0, 1] to linear light."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def compose(rendered, scene, poses, i, rng, noise):
    """Put the backdrop behind a rendered RGBA image; returns the photo and its sky mask."""
    height, width = rendered.shape[:2]
    alpha = rendered[..., 3].reshape(-1) / 255.0
    linear = decode_srgb(rendered[..., :3].reshape(-1, 3) / 255.0)
    behind = np.flatnonzero(alpha < 1.0)
    rays = pixel_rays(poses.K[i], poses.cam_from_world[i], width, height)[behind]
    radiance, is_sky = backdrop(rays, scene.light.sky, scene.seed)
    a = alpha[behind, None]
    linear[behind] = a * linear[behind] + (1.0 - a) * radiance
    mask = np.zeros(len(alpha), bool)
    mask[behind] = is_sky & (alpha[behind] < 0.5)
    photo = encode_srgb(linear) + rng.normal(size=linear.shape) * noise
    photo = np.round(255 * np.clip(photo, 0, 1)).astype(np.uint8)
    return photo.reshape(height, width, 3), mask.reshape(height, width)


def exif_of(camera):
    """EXIF block that names the camera and its focal length."""
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = camera.make, camera.model
    details = exif.get_ifd(0x8769)
    details[0x920A] = IFDRational(round(100 * camera.focal_mm), 100)
    details[0xA405] = int(round(camera.focal_35mm))
    details[0xA002], details[0xA003] = camera.width, camera.height
    return exif


def write_jpeg(path, photo, camera, quality):
    """Write a photo with EXIF; never leaves half a file."""
    buffer = io.BytesIO()
    Image.fromarray(photo).save(
        buffer, "JPEG", quality=quality, optimize=True, subsampling="4:2:0", exif=exif_of(camera)
    )
    with atomic_path(path) as partial:
        Path(partial).write_bytes(buffer.getvalue())


def render(scene, poses, camera, folder, args):
    """Render the photos that are still missing."""
    photos = Path(folder) / "photos"
    photos.mkdir(parents=True, exist_ok=True)
    wanted = range(len(poses)) if args.only is None else args.only
    missing = [i for i in wanted if not (photos / str(poses.names[i])).exists()]
    if not missing:
        logger.info("all photos are there")
        return
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    with tempfile.TemporaryDirectory() as scratch:
        start = time.perf_counter()
        eye = set_up(bpy, scene, camera, args.samples, args.threads)
        add_things(bpy, scene, scratch)
        add_ground(bpy, scene, scratch)
        logger.info("scene built in %.0f s", time.perf_counter() - start)
        target = str(Path(scratch) / "render.png")
        bpy.context.scene.render.filepath = target
        start = time.perf_counter()
        for count, i in enumerate(missing, start=1):
            place(eye, poses.cam_from_world[i])
            bpy.ops.render.render(write_still=True)
            rendered = np.asarray(Image.open(target).convert("RGBA"))
            rng = np.random.default_rng([scene.seed, 81, i])
            photo, sky = compose(rendered, scene, poses, i, rng, args.noise)
            if args.masks:
                mask_path = Path(args.masks) / Path(str(poses.names[i])).with_suffix(".png")
                mask_path.parent.mkdir(parents=True, exist_ok=True)
                Image.fromarray(np.where(sky, 255, 0).astype(np.uint8)).save(mask_path)
            write_jpeg(photos / str(poses.names[i]), photo, camera, args.quality)
            each = (time.perf_counter() - start) / count
            left = each * (len(missing) - count)
            logger.info("photo %d of %d, %.1f s each, %.0f s left", count, len(missing), each, left)


def parse_arguments():
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--preset", choices=sorted(PRESETS), help="a named scene")
    which.add_argument("--seed", type=int, help="a random scene of this seed")
    parser.add_argument("--output", required=True, help="folder of the scene, made if missing")
    parser.add_argument("--samples", type=int, default=4, help="Cycles samples a pixel (4)")
    parser.add_argument("--threads", type=int, default=2, help="render threads (2)")
    parser.add_argument("--quality", type=int, default=80, help="JPEG quality (80)")
    parser.add_argument("--noise", type=float, default=0.006, help="sensor noise, of 1 (0.006)")
    parser.add_argument("--only", type=int, nargs="+", help="render only these photos, from 0")
    parser.add_argument("--masks", help="folder for exact sky masks (none written by default)")
    parser.add_argument("--truth-only", action="store_true", help="write the truth, no photos")
    return parser.parse_args()


def main():
    """Write the truth, then the photos."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    args = parse_arguments()
    if args.preset:
        preset = PRESETS[args.preset]
        scene, camera, rings = generate_scene(**preset["scene"]), preset["camera"], preset["rings"]
    else:
        scene, camera = generate_scene(args.seed), CameraModel()
        rings = [Ring(20, 1.1, 2.6, 1.1), Ring(20, 1.9, 2.5, 1.1, 0.16), Ring(8, 0.6, 2.5, 1.2)]
    poses = ring_poses(
        rings,
        camera,
        seed=scene.seed,
        ground=scene.ground_height,
        obstacles=scene.neighbour_wood(),
    )
    write_truth(Path(args.output) / "truth", scene, poses, name=args.preset or f"seed {args.seed}")
    if not args.truth_only:
        render(scene, poses, camera, args.output, args)


if __name__ == "__main__":
    main()
