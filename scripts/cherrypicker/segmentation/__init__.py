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
    Clean-up of the network's probabilities and of the trunk class.
support_post
    Split of the support post from the trunk.
quick_skeleton, stem_axis, stem_labels
    The stems' course and thickness by geometry, which decide between trunk and branch.
augment, training
    Training data and the training loop.
metrics
    Confusion matrix, intersection over union, F1.
"""
