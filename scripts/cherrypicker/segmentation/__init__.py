"""Semantic segmentation of metric clouds into tree organs (paper, section Point Cloud Segmentor).

Modules
-------
dgcnn
    The network: EdgeConv layers on nearest-neighbour graphs of our own, checkpoints.
spheres
    Voxel sampling, normalised features, overlapping spheres and their graphs.
inference
    Labels and confidences for every point of a cloud.
refine
    Clean-up of the network's probabilities: a vote, and roofs that are no sheets.
support_post, standing_posts
    Support posts split from the trunk, and found in wood that is not called trunk.
stems
    The limbs of every tree, which decide between trunk and branch.
white_rings
    White rings around traced stems.

`cherrypicker_lab.training.segmentation` trains and measures it.
"""
