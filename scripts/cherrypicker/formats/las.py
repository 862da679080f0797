"""The labelled cloud as LAS 1.4: a class and a ``branch_id`` a point.

The classification is that of the ASPRS where it has the class, else one of the codes that it leaves
to the user; `label` holds our own. Reference: ASPRS, LAS Specification 1.4 R15, table 17.
"""

import os

import laspy
import numpy as np

from cherrypicker.classes import Label
from cherrypicker.files import atomic_path
from cherrypicker.pointcloud import PointCloud

ASPRS = {
    Label.GROUND: 2,
    Label.TRUNK: 5,  # high vegetation
    Label.BRANCH: 5,
    Label.ROOF: 6,  # building
    Label.UNLABELLED: 1,
}
_FIRST_OF_USER = 64
_RESOLUTION_M = 1e-4


def write_las(path: str | os.PathLike, cloud: PointCloud) -> None:
    """Write a cloud with the fields ``label``, ``branch_id`` and ``confidence``, where it has them.

    Coordinates are rounded to 0.1 mm, in the cloud's own frame: there is no coordinate system.
    """
    header = laspy.LasHeader(version="1.4", point_format=6 if cloud.colors is None else 7)
    header.scales = np.full(3, _RESOLUTION_M)
    header.offsets = np.floor(cloud.points.min(axis=0))
    header.generating_software = "CherryPicker"
    own = {"label": "u1", "branch_id": "i4", "confidence": "f4"}
    own = {name: kind for name, kind in own.items() if name in cloud}
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind) for name, kind in own.items()])
    las = laspy.LasData(header)
    las.xyz = cloud.points
    codes = np.arange(256) % (256 - _FIRST_OF_USER) + _FIRST_OF_USER
    for label, code in ASPRS.items():
        codes[label] = code
    las.classification = codes[cloud["label"]].astype(np.uint8)
    if cloud.colors is not None:
        levels = np.rint(cloud.colors.astype(np.float64) * np.iinfo("u2").max).astype("u2")
        las.red, las.green, las.blue = levels.T
    for name in own:
        las[name] = cloud[name]
    with atomic_path(path) as temporary:
        las.write(temporary)
