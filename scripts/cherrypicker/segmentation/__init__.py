"""Semantic segmentation of metric clouds into tree organs (paper, section Point Cloud Segmentor).

Modules
-------
dgcnn
    The network: EdgeConv layers on nearest-neighbour graphs of our own, checkpoints.
spheres
    Voxel sampling, normalised features, overlapping spheres and their graphs.
inference
    Labels and confidences for every point of a cloud, and the limbs of its trees.
known_markers
    Where the markers stand, as the scale stage solved them.
things
    Thing or wood first, which thing second.
stems
    What the limbs of every tree say: trunk and branch, what lies in a tube, the foot.
white_rings
    White rings around traced stems.

`cherrypicker_lab.training.segmentation` trains and measures it.
"""
