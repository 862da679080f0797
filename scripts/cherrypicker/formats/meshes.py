"""A tree's tubes as Wavefront OBJ and as binary glTF 2.0, an object an axis."""

import json
import os
import struct

import numpy as np

from cherrypicker.files import atomic_path, write_text
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.formats.tubes import axis_tubes

_BARK = (0.45, 0.33, 0.24, 1.0)
# glTF 2.0: types of numbers and what a buffer is for
_FLOAT, _UNSIGNED_INT, _VERTICES, _INDICES = 5126, 5125, 34962, 34963
_Z_UP_TO_Y_UP = (-0.7071067811865476, 0.0, 0.0, 0.7071067811865476)  # a quaternion x, y, z, w


def write_obj(path: str | os.PathLike, tree: MeasuredTree) -> None:
    """Write OBJ: z up, one object ``branch_ID`` an axis."""
    lines = [f"# {tree.name}, unit={tree.skeleton.unit}, z up"]
    n_before = 1
    for axis, vertices, faces in axis_tubes(tree):
        lines.append(f"o branch_{axis}")
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (faces + n_before).tolist()]
        n_before += len(vertices)
    write_text(path, "\n".join(lines) + "\n")


def write_glb(path: str | os.PathLike, tree: MeasuredTree) -> None:
    """Write binary glTF: y up as the format asks, one node ``branch_ID`` an axis."""
    parts: list[bytes] = []
    views, accessors, meshes, nodes = [], [], [], []
    origin = tree.skeleton.points[0]  # places are float32, told from the root

    def add(values: np.ndarray, target: int, number: int, kind: str, **bounds: list) -> int:
        """Enter an array; return the number of its accessor."""
        place = {"buffer": 0, "byteOffset": sum(map(len, parts)), "byteLength": values.nbytes}
        views.append(place | {"target": target})
        parts.append(values.tobytes())
        accessor = {"bufferView": len(views) - 1, "componentType": number, "count": len(values)}
        accessors.append(accessor | {"type": kind} | bounds)
        return len(accessors) - 1

    for axis, vertices, faces in axis_tubes(tree):
        places = (vertices - origin).astype("<f4")
        bounds = {"min": places.min(axis=0).tolist(), "max": places.max(axis=0).tolist()}
        primitive = {
            "attributes": {"POSITION": add(places, _VERTICES, _FLOAT, "VEC3", **bounds)},
            "indices": add(faces.astype("<u4").ravel(), _INDICES, _UNSIGNED_INT, "SCALAR"),
            "material": 0,
        }
        extras = {"branch_id": axis, "order": tree.axis_list[axis].order}
        meshes.append({"primitives": [primitive]})
        nodes.append({"mesh": len(meshes) - 1, "name": f"branch_{axis}", "extras": extras})
    root = {
        "name": tree.name,
        "children": list(range(len(nodes))),
        "rotation": _Z_UP_TO_Y_UP,
        "extras": {"unit": tree.skeleton.unit, "origin": origin.tolist()},
    }
    binary = b"".join(parts)
    colour = {"baseColorFactor": _BARK, "metallicFactor": 0.0, "roughnessFactor": 1.0}
    content = {
        "asset": {"version": "2.0", "generator": "CherryPicker"},
        "scene": 0,
        "scenes": [{"nodes": [len(nodes)]}],
        "nodes": [*nodes, root],
        "meshes": meshes,
        "materials": [{"name": "bark", "pbrMetallicRoughness": colour}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = [(text, b"JSON"), (binary, b"BIN\0")]
    packed = b"".join(struct.pack("<I4s", len(chunk), kind) + chunk for chunk, kind in chunks)
    with atomic_path(path) as temporary:
        temporary.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(packed)) + packed)
