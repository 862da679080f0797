"""What the header of a LAS or LAZ file promises, held against the file before memory is taken.

References: ASPRS, LAS Specification 1.4 R15, table 3; LASzip Specification 1.4 R1: compressed
points come in chunks, of the newer point types each with the lengths of its layers at its start.
"""

import struct
from pathlib import Path

from cherrypicker.errors import StageError

_RECORDS_AT, _RECORD_BYTES = 96, 54
_LAYERED = 3  # LASzip's compressor with layers
# Layers of an item of a point by its type: POINT14, RGB14, RGBNIR14, WAVEPACKET14; of BYTE14, 14,
# one a byte
_LAYERS, _BYTES_ITEM = {10: 9, 11: 1, 12: 2, 13: 1}, 14


def check_las_promise(path: Path) -> None:
    """Refuse, by a StageError, a file that is shorter than its header says.

    How many points a chunk holds is for the decoder to see, and records after the points are not
    read.
    """
    import laspy

    size = path.stat().st_size

    def refuse(what: str, needed: int) -> None:
        if needed > size:
            raise StageError(
                f"the LAS header promises {what} of {needed:,} bytes, the file holds {size:,}",
                file=path,
            )

    with open(path, "rb") as stream:
        head = stream.read(_RECORDS_AT + 8).ljust(_RECORDS_AT + 8, b"\0")
        start, n_records = struct.unpack_from("<II", head, _RECORDS_AT)
        refuse("points", start)
        refuse("records", n_records * _RECORD_BYTES)
        stream.seek(0)
        header = laspy.LasHeader.read_from(stream)
        length = header.point_format.size
        if not header.are_points_compressed:
            refuse("points", start + header.point_count * length)
            return
        table = 0
        for place in (start, size - 8):  # who wrote a stream put the table's place at its end
            stream.seek(max(place, 0))
            table = table if table > 0 else int.from_bytes(stream.read(8), "little", signed=True)
        table = min(max(table, 0), size)
        stream.seek(table + 4)
        n_chunks = int.from_bytes(stream.read(4), "little")
        refuse("chunks", n_chunks * length)  # the first point of a chunk stands there as it is
        at, lengths = start + 8, _layer_lengths(header.vlrs.get("LasZipVlr")[0].record_data)
        while lengths.size and at < table:  # without layers a point is read at a time
            stream.seek(at + length + 4)  # after the first point and the number of points
            content = stream.read(lengths.size).ljust(lengths.size, b"\0")
            at += length + 4 + lengths.size + sum(lengths.unpack(content))
        refuse("chunks", at)


def _layer_lengths(record: bytes) -> struct.Struct:
    """The lengths of each chunk's layers by LASzip's own record; nothing where it has none."""
    if len(record) < 34 or int.from_bytes(record[:2], "little") != _LAYERED:
        return struct.Struct("")
    n_items = int.from_bytes(record[32:34], "little")
    items = struct.iter_unpack("<HHH", record[34 : 34 + 6 * min(n_items, (len(record) - 34) // 6)])
    n_layers = sum(n if kind == _BYTES_ITEM else _LAYERS.get(kind, 0) for kind, n, _ in items)
    return struct.Struct(f"<{n_layers}I")
