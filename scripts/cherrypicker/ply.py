"""Vertex tables in PLY: ASCII, little- and big-endian in, little-endian out.

Own code, because the kept readers drop what the data contract needs: Open3D loses labels and other
scalar fields, and none checks the vertex count against the file.
"""

import os
from dataclasses import dataclass

import numpy as np

_NAMES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}
# Files name types by either of two names, uchar or uint8 for instance
_TYPES = {name: kind for kind, own in _NAMES.items() for name in (own, np.dtype(kind).name)}
_MAX_HEADER_BYTES = 1 << 20


class PlyError(ValueError):
    """The file is not a PLY that holds what its header promises."""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str]]
    has_list: bool = False


def read_ply_header(path: str | os.PathLike) -> tuple[str, list[_Element], list[str], int]:
    """Return format, elements, comments and the byte offset of the body.

    Raises
    ------
    PlyError
        If the header is not that of a PLY file.
    """
    with open(path, "rb") as stream:
        head = stream.read(_MAX_HEADER_BYTES)
    end = head.find(b"end_header")
    if not head.startswith(b"ply") or end < 0:
        raise PlyError("not a PLY file (no 'ply' ... 'end_header')")
    newline = head.find(b"\n", end)
    offset = newline + 1 if newline >= 0 else len(head)
    encoding, elements, comments = "", [], []
    for raw in head[:end].decode("latin-1").splitlines()[1:]:
        words = raw.split()
        try:
            if not words:
                continue
            if words[0] == "format":
                encoding = words[1]
            elif words[0] == "comment":
                comments.append(" ".join(words[1:]))
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2]), []))
            elif words[0] == "property":
                if words[1] == "list":
                    elements[-1].has_list = True
                else:
                    elements[-1].properties.append((words[2], _TYPES[words[1]]))
        except (IndexError, ValueError, KeyError) as error:
            raise PlyError(f"broken PLY header line {raw.strip()!r}") from error
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise PlyError(f"unknown PLY format {encoding!r}")
    return encoding, elements, comments, offset


def vertex_properties(path: str | os.PathLike) -> list[str]:
    """Return the names of the vertex properties, reading the header only."""
    _, elements, _, _ = read_ply_header(path)
    return [
        name for element in elements if element.name == "vertex" for name, _ in element.properties
    ]


def read_ply_vertices(path: str | os.PathLike) -> tuple[dict[str, np.ndarray], list[str]]:
    """Read the vertex element, property by property.

    Returns
    -------
    columns : dict of str to ndarray of shape (n_vertices,)
        In the file's order and types, native byte order.
    comments : list of str
        The header's comment lines.

    Raises
    ------
    PlyError
        If the vertex element is missing, not the first, or shorter or longer than promised.
    """
    encoding, elements, comments, offset = read_ply_header(path)
    if not elements or elements[0].name != "vertex":
        raise PlyError("the PLY's first element is not 'vertex'")
    vertex = elements[0]
    if vertex.has_list:
        raise PlyError("the PLY's vertices have a list property, which a point cloud cannot have")
    if not vertex.properties:
        raise PlyError("the PLY's vertices have no properties")
    if vertex.count < 0:
        raise PlyError(f"the header promises {vertex.count:,} vertices")
    is_alone = len(elements) == 1
    names = [name for name, _ in vertex.properties]
    if len(set(names)) != len(names):
        raise PlyError("the PLY's vertices have a property twice")
    if encoding == "ascii":
        return _read_ascii(path, vertex, offset, is_alone), comments
    order = "<" if encoding == "binary_little_endian" else ">"
    dtype = np.dtype([(name, order + kind) for name, kind in vertex.properties])
    available = max(os.path.getsize(path) - offset, 0) // dtype.itemsize
    if available < vertex.count or (is_alone and available > vertex.count):
        raise PlyError(
            f"the header promises {vertex.count:,} vertices, the file holds {available:,}"
        )
    table = np.fromfile(path, dtype=dtype, count=vertex.count, offset=offset)
    columns = {name: table[name].astype(kind) for name, kind in vertex.properties}
    return columns, comments


def write_ply_vertices(
    path: str | os.PathLike,
    columns: dict[str, np.ndarray],
    comments: list[str] | None = None,
    edges: np.ndarray | None = None,
) -> None:
    """Write a vertex table, and optionally edges, as binary little-endian PLY.

    Parameters
    ----------
    columns : dict of str to ndarray of shape (n_vertices,)
        Numeric columns; booleans become uchar, 64-bit integers int.
    edges : ndarray of shape (n_edges, 2), optional
        Vertex rows, written as the PLY element ``edge``.
    """
    kinds = {name: _kind_of(name, values) for name, values in columns.items()}
    n_vertices = len(next(iter(columns.values())))
    table = np.empty(n_vertices, dtype=[(name, "<" + kind) for name, kind in kinds.items()])
    for name, values in columns.items():
        table[name] = values
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {line}" for line in comments or []]
    lines.append(f"element vertex {n_vertices}")
    lines += [f"property {_NAMES[kind]} {name}" for name, kind in kinds.items()]
    if edges is not None:
        lines += [f"element edge {len(edges)}", "property int vertex1", "property int vertex2"]
    lines.append("end_header")
    with open(path, "wb") as stream:
        stream.write(("\n".join(lines) + "\n").encode("ascii", errors="replace"))
        stream.write(table.tobytes())
        if edges is not None:
            stream.write(np.ascontiguousarray(edges, dtype="<i4").tobytes())


def _read_ascii(
    path: str | os.PathLike, vertex: _Element, offset: int, is_alone: bool
) -> dict[str, np.ndarray]:
    n_columns = len(vertex.properties)
    # One row beyond the promise tells that there are more. loadtxt makes room for as many rows as
    # it is told; a row takes two bytes at least, with its end.
    n_held = max(os.path.getsize(path) - offset, 0) // 2 + 1
    n_rows = min(vertex.count + is_alone, n_held)
    table = np.empty((0, n_columns))
    with open(path, "rb") as stream:
        stream.seek(offset)
        try:
            if vertex.count:
                table = np.loadtxt(stream, max_rows=n_rows, ndmin=2)
        except ValueError as error:
            raise PlyError(f"broken ASCII vertex table ({error})") from error
    if table.shape != (vertex.count, n_columns):
        raise PlyError(
            f"the header promises {vertex.count:,} vertices of {n_columns} values, "
            f"the file holds {'more' if len(table) > vertex.count else f'{len(table):,}'} "
            f"of {table.shape[1]}"
        )
    return {
        name: _as_kind(name, table[:, i], kind) for i, (name, kind) in enumerate(vertex.properties)
    }


def _as_kind(name: str, values: np.ndarray, kind: str) -> np.ndarray:
    """Return ``values`` in a property's type; a number that an integer type cannot hold is refused.

    A cast would turn the label 257 of a uchar into 1.
    """
    if kind[0] in "iu":
        bounds = np.iinfo(kind)
        is_held = (values >= bounds.min) & (values <= bounds.max) & (values == np.rint(values))
        if not is_held.all():
            first = values[~is_held][0]
            raise PlyError(f"{name} {first:g} is no {_NAMES[kind]}, the type that the header gives")
    return values.astype(kind)


def _kind_of(name: str, values: np.ndarray) -> str:
    dtype = np.asarray(values).dtype
    if dtype.kind == "b":
        return "u1"
    if dtype in (np.int64, np.uint64):
        return "i4"
    kind = dtype.kind + str(dtype.itemsize)
    if kind not in _NAMES:
        raise TypeError(f"column {name!r} has dtype {dtype}, which PLY cannot hold")
    return kind
