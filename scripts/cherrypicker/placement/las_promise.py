"""What the header of a LAS or LAZ file promises, held against the file before memory is taken.

References: ASPRS, LAS Specification 1.4 R15, table 3; LASzip Specification 1.4 R1: compressed
points come in chunks, of the newer point types each with the lengths of its layers at its start.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from cherrypicker.errors import StageError

__all__ = ["check_las_promise"]

_HEAD_BYTES, _VLR_BYTES, _EVLR_BYTES = 255, 54, 60
_COMPRESSED = 128  # bit of the point format
_LASZIP, _LAYERED = b"laszip encoded", 3  # the user of its record, the compressor with layers
# Layers of an item of a point by its type: POINT14, RGB14, RGBNIR14, WAVEPACKET14; of BYTE14, 14,
# one a byte
_LAYERS, _BYTES_ITEM = {10: 9, 11: 1, 12: 2, 13: 1}, 14


def check_las_promise(path: Path) -> None:
    """Refuse a file that is shorter than its header says.

    How many points a chunk holds is for the decoder to see.

    Raises
    ------
    StageError
    """
    size = path.stat().st_size
    with open(path, "rb") as stream:
        head = stream.read(_HEAD_BYTES).ljust(_HEAD_BYTES, b"\0")
        start, n_records = struct.unpack_from("<II", head, 96)
        kind, length, n_points = struct.unpack_from("<BHI", head, 104)
        later = n_later = 0
        if head[24:26] >= b"\1\4":
            later, n_later, n_long = struct.unpack_from("<QIQ", head, 235)
            n_points = max(n_points, n_long)
        promised = {
            "records": n_records * _VLR_BYTES,
            "later records": later * bool(n_later) + n_later * _EVLR_BYTES,
            "points": start + (n_points * length if kind < _COMPRESSED else 0),
        }
        _refuse(promised, size, path)
        if kind >= _COMPRESSED:
            table, n_chunks = _chunk_table(stream, start, size)
            # The first point of a chunk stands there as it is
            _refuse({"chunks": n_chunks * length}, size, path)
            end = _end_of_chunks(stream, start, table, length, size)
            _refuse({"chunks": end}, size, path)


def _refuse(promised: dict[str, int], size: int, path: Path) -> None:
    for what, needed in promised.items():
        if needed > size:
            raise StageError(
                f"the LAS header promises {what} of {needed:,} bytes, the file holds {size:,}",
                file=path,
            )


def _chunk_table(stream: BinaryIO, start: int, size: int) -> tuple[int, int]:
    """Where the table of chunks is, and how many it promises."""
    table = 0
    for place in (start, size - 8):  # who wrote a stream put the table's place at its end
        stream.seek(max(place, 0))
        table = int.from_bytes(stream.read(8), "little", signed=True)
        if table > 0:
            break
    table = min(max(table, 0), size)
    stream.seek(table + 4)
    return table, int.from_bytes(stream.read(4), "little")


def _end_of_chunks(stream: BinaryIO, start: int, table: int, length: int, size: int) -> int:
    """Where the chunks of layers end that stand before the table, by their own lengths.

    The start of the points for those without layers, which are read a point at a time.
    """
    n_layers = _count_layers(stream, start)
    at = start
    if n_layers:
        at += 8  # the table's place
        lengths = struct.Struct(f"<{n_layers}I")
        while at < min(table, size):
            stream.seek(at + length + 4)  # after the first point and the number of points
            content = stream.read(lengths.size).ljust(lengths.size, b"\0")
            at += length + 4 + lengths.size + sum(lengths.unpack(content))
    return at


def _count_layers(stream: BinaryIO, start: int) -> int:
    """Layers of each chunk by LASzip's own record before the points; 0 where it has none."""
    stream.seek(0)
    before = stream.read(start)
    found = before.find(_LASZIP)
    record = before[found + _VLR_BYTES - 2 :] if found >= 0 else b""
    if len(record) < 34 or int.from_bytes(record[:2], "little") != _LAYERED:
        return 0
    n_items = int.from_bytes(record[32:34], "little")
    items = struct.iter_unpack("<HHH", record[34 : 34 + 6 * min(n_items, (len(record) - 34) // 6)])
    return sum(n if kind == _BYTES_ITEM else _LAYERS.get(kind, 0) for kind, n, _ in items)
