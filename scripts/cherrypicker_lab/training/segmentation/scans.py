"""Scans that somebody labelled, to train on beside generated scenes (the paper trained on 16)."""

import logging

import numpy as np

from cherrypicker.classes import CLASS_NAMES, Label, wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import read_table
from cherrypicker.pointcloud import read_cloud
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.training.segmentation.augment import Sample
from cherrypicker_lab.training.segmentation.random_props import NO_WOOD

logger = logging.getLogger(__name__)

COLUMN = "cloud"
FIELDS = ("label", "scalar_label", "scalar_Label")  # CloudCompare writes its own prefix

KEY = "train_segment.scans"


def load_scans(table):
    """Labelled clouds of a table, a `Sample` each; all wood is taken for one tree's.

    The table is tab-separated, with a column ``cloud``: PLY files, relative to the working
    directory, of a scan each in metres, z up: x y z, red green blue where there are colours, and
    ``label`` with the ids of `cherrypicker.classes.Label`; 255 where it is not known, 254 for what
    belongs to no class but is no wood. A file named twice counts twice. Where the table or a cloud
    cannot be used, a `StageError` says the file, the row and the key.
    """
    samples = []
    try:
        rows = read_table(table, (COLUMN,), delimiter="\t")
    except StageError as error:
        raise StageError(error.cause, file=table, key=KEY) from error
    for row, cells in rows:
        name = cells[COLUMN].strip()
        where = f"{KEY}, line {row} of {table}"
        try:
            cloud = read_cloud(name)
        except StageError as error:
            raise StageError(error.cause, file=name, key=where) from error
        field = next((each for each in FIELDS if each in cloud), None)
        if field is None:
            raise StageError("the point cloud has no label", file=name, key=where)
        labels = np.asarray(cloud[field])
        ids = np.unique(labels)
        if unknown := [f"{each:g}" for each in ids if each not in (*CLASS_NAMES, NO_WOOD)]:
            raise StageError(f"no class has the label {', '.join(unknown)}", file=name, key=where)
        if (ids == Label.UNLABELLED).all():
            raise StageError("no point has a label", file=name, key=where)
        labels = labels.astype(np.uint8)
        colors = None if cloud.colors is None else np.rint(cloud.colors * 255).astype(np.uint8)
        points = cloud.points - np.median(cloud.points, axis=0)  # float32 holds no map coordinates
        trees = np.where(wood_mask(labels), 0, NO_TREE).astype(np.uint8)
        samples.append(Sample(points.astype(np.float32), colors, labels, trees))
        logger.info("labelled scan %s: %s points", name, f"{len(labels):,}")
    return samples
