"""The network: EdgeConv against torch-geometric's own, batches, weights on disk."""

import numpy as np
import pytest
import torch
from torch_geometric.nn import EdgeConv

from cherrypicker.errors import StageError
from cherrypicker.segmentation.dgcnn import (
    N_CLASSES,
    N_CLASSES_BEFORE,
    Dgcnn,
    LinearEdgeConv,
    choose_device,
    collate,
    load_weights,
    save_weights,
)
from cherrypicker.segmentation.spheres import features_of, neighbor_graphs

SAMPLING = {"voxel_size_m": 0.02, "sphere_radius_m": 0.7, "sphere_points": 2048}


@pytest.fixture(autouse=True)
def one_thread():
    choose_device(1, 0)


def _sphere(n, seed, k=6):
    points = np.random.default_rng(seed).random((n, 3))
    return features_of(points, None, points.mean(axis=0), 1.0), neighbor_graphs(points, k, 3)


def test_linear_edge_conv_equals_the_edge_conv_of_torch_geometric():
    torch.manual_seed(0)
    conv = LinearEdgeConv(5, 7)
    x = torch.randn(40, 5, requires_grad=True)
    neighbors = torch.randint(0, 40, (40, 6), dtype=torch.int32)
    edges = torch.stack([torch.arange(40).repeat_interleave(6), neighbors.reshape(-1).long()]).flip(
        0
    )
    ours, theirs = conv(x, neighbors), EdgeConv.forward(conv, x, edges)
    assert torch.allclose(ours, theirs, atol=1e-5)
    pull = torch.randn_like(ours)
    parameters = [x, conv.nn.weight, conv.nn.bias]
    for a, b in zip(
        torch.autograd.grad((ours * pull).sum(), parameters),
        torch.autograd.grad((theirs * pull).sum(), parameters),
    ):
        assert torch.allclose(a, b, atol=1e-4)


def test_rows_are_log_probabilities_and_spheres_of_a_batch_do_not_mix():
    torch.manual_seed(1)
    network = Dgcnn(width=8, embedding=16, k=6).eval()
    first, second = _sphere(50, 0), _sphere(80, 1)
    with torch.inference_mode():
        together = network(*collate([first, second]))
        alone = network(*collate([second]))
    assert together.shape == (130, N_CLASSES)
    assert torch.allclose(together.exp().sum(dim=1), torch.ones(130), atol=1e-5)
    assert torch.allclose(together[50:], alone, atol=1e-5)


def test_weights_survive_a_round_trip(tmp_path):
    torch.manual_seed(2)
    network = Dgcnn(width=8, embedding=16, scales=(0, 1), k=6).eval()
    save_weights(tmp_path / "w.pt", network, SAMPLING, {"epochs": 3})
    again, sampling, meta = load_weights(tmp_path / "w.pt")
    assert sampling == SAMPLING and meta == {"epochs": 3}
    assert again.settings == network.settings
    batch = collate([_sphere(50, 3)])
    with torch.inference_mode():
        assert torch.equal(network(*batch), again(*batch))


@pytest.mark.parametrize("content", [None, b"not torch"])
def test_unusable_weights_name_the_file_and_the_key(tmp_path, content):
    path = tmp_path / "w.pt"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(StageError, match="segment.weights") as caught:
        load_weights(path)
    assert str(path) in str(caught.value)


def test_weights_of_other_classes_are_refused(tmp_path):
    network = Dgcnn()
    last = [module for module in network.modules() if isinstance(module, torch.nn.Linear)][-1]
    last.weight = torch.nn.Parameter(last.weight[:-1])
    save_weights(tmp_path / "w.pt", network, SAMPLING, {})
    with pytest.raises(StageError, match=f"do not fit the network of {N_CLASSES} classes"):
        load_weights(tmp_path / "w.pt")


def test_weights_that_do_not_say_their_outputs_have_those_of_before(tmp_path):
    network = Dgcnn(width=8, embedding=16, k=6, n_classes=N_CLASSES_BEFORE).eval()
    del network.settings["n_classes"]
    save_weights(tmp_path / "w.pt", network, SAMPLING)
    again, _, _ = load_weights(tmp_path / "w.pt")
    with torch.inference_mode():
        assert again(*collate([_sphere(50, 3)])).shape == (50, N_CLASSES_BEFORE)


def test_another_kind_of_torch_file_is_refused(tmp_path):
    torch.save({"state": {}}, tmp_path / "w.pt")
    with pytest.raises(StageError, match="not a file of segmentation weights"):
        load_weights(tmp_path / "w.pt")
