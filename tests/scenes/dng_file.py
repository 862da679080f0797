"""A raw photo as small as LibRaw takes it: an uncompressed DNG with a Bayer pattern."""

import struct

import numpy as np

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_CODES = {_BYTE: "B", _SHORT: "H", _LONG: "I", _RATIONAL: "II", _SRATIONAL: "ii"}


def write_dng(path, image, orientation=1, make="Orchard", model="Raw One", focal_mm=35):
    """Write an RGB image (height, width, 3) uint8 with even sides as RGGB of 16 bits."""
    height, width = image.shape[:2]
    linear = ((image / 255.0) ** 2.2 * 65535).astype("<u2")
    mosaic = linear[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = linear[::2, ::2, 0], linear[1::2, 1::2, 2]
    one = [value for row in np.eye(3, dtype=int) for cell in row for value in (cell, 1)]
    exif = {0x920A: (_RATIONAL, [focal_mm, 1]), 0xA405: (_SHORT, [focal_mm])}
    tags = {
        254: (_LONG, [0]),
        256: (_LONG, [width]),
        257: (_LONG, [height]),
        258: (_SHORT, [16]),
        259: (_SHORT, [1]),
        262: (_SHORT, [32803]),  # colour filter array
        271: (_ASCII, make.encode() + b"\0"),
        272: (_ASCII, model.encode() + b"\0"),
        273: (_LONG, [0]),  # where the strip begins, below
        274: (_SHORT, [orientation]),
        277: (_SHORT, [1]),
        278: (_LONG, [height]),
        279: (_LONG, [mosaic.nbytes]),
        33421: (_SHORT, [2, 2]),
        33422: (_BYTE, [0, 1, 1, 2]),
        34665: (_LONG, [0]),  # where the EXIF tags are, below
        50706: (_BYTE, [1, 4, 0, 0]),
        50708: (_ASCII, model.encode() + b"\0"),
        50717: (_LONG, [65535]),
        50721: (_SRATIONAL, one),
        50728: (_RATIONAL, [1, 1, 1, 1, 1, 1]),
        50778: (_SHORT, [21]),
    }
    exif_at = 8
    first_at = exif_at + len(_directory(exif, exif_at))
    strip_at = first_at + len(_directory(tags, first_at))
    tags[273], tags[34665] = (_LONG, [strip_at]), (_LONG, [exif_at])
    content = b"II*\0" + struct.pack("<I", first_at) + _directory(exif, exif_at)
    path.write_bytes(content + _directory(tags, first_at) + mosaic.tobytes())


def _directory(tags, at):
    """An IFD that begins at a byte of the file, with what does not fit into its entries."""
    entries, rest = b"", b""
    rest_at = at + 2 + 12 * len(tags) + 4
    for tag, (kind, values) in sorted(tags.items()):
        if kind == _ASCII:
            data, count = values, len(values)
        else:
            per_value = len(_CODES[kind])
            data = struct.pack(f"<{_CODES[kind] * (len(values) // per_value)}", *values)
            count = len(values) // per_value
        if len(data) > 4:
            entries += struct.pack("<HHII", tag, kind, count, rest_at + len(rest))
            rest += data + b"\0" * (len(data) % 2)
        else:
            entries += struct.pack("<HHI", tag, kind, count) + data.ljust(4, b"\0")
    return struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0) + rest
