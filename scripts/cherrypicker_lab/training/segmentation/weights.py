"""Weights of the network on disk, as `cherrypicker.segmentation.dgcnn.load_weights` reads them."""

import torch

from cherrypicker.files import atomic_path
from cherrypicker.segmentation.dgcnn import CHECKPOINT_FORMAT


def save_weights(path, network, sampling, meta=None):
    """Write the network's weights with all that inference needs.

    The sampling has the ``voxel_size_m``, ``reference_height_m``, ``sphere_radius_m`` and
    ``sphere_points`` that the network was trained at; `meta` has plain values for the model card
    (epochs, seeds, metrics).
    """
    content = {
        "format": CHECKPOINT_FORMAT,
        "settings": network.settings,
        "sampling": dict(sampling),
        "meta": dict(meta or {}),
        "state": {name: tensor.detach().cpu() for name, tensor in network.state_dict().items()},
    }
    with atomic_path(path) as temporary:
        torch.save(content, temporary)
