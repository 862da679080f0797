"""The network: EdgeConv against torch-geometric's own, batches, weights on disk."""

import numpy as np
import pytest
import torch
from torch_geometric.nn import EdgeConv

from cherrypicker.errors import StageError
from cherrypicker.pointcloud import PointCloud
from cherrypicker.segmentation.dgcnn import (
    N_CLASSES,
    Dgcnn,
    LinearEdgeConv,
    choose_device,
    collate,
    load_weights,
    nearest_features,
)
from cherrypicker.segmentation.inference import Sampling, predict_spheres, segment_cloud
from cherrypicker.segmentation.spheres import features_of, neighbor_graphs
from cherrypicker_lab.training.segmentation.weights import save_weights

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


@pytest.mark.parametrize("sizes", [[40], [25, 40], [3, 40]])
def test_a_dynamic_graph_is_the_edge_conv_over_neighbours_in_feature_space(sizes):
    """What torch-geometric's DynamicEdgeConv computes, from edges that numpy finds."""
    torch.manual_seed(0)
    conv, h, k = LinearEdgeConv(5, 7), torch.randn(sum(sizes), 5), 6
    starts = np.cumsum([0, *sizes])
    edges = []
    for first, last in zip(starts, starts[1:]):
        part = h[first:last].numpy()
        apart = np.linalg.norm(part[:, None] - part[None], axis=2)
        for row, others in enumerate(np.argsort(apart, axis=1)[:, :k]):
            edges += [(first + other, first + row) for other in others]
    expected = EdgeConv.forward(conv, h, torch.tensor(edges).T)
    assert torch.allclose(conv(h, nearest_features(h, sizes, k)), expected, atol=1e-5)


def test_the_graph_is_a_setting_of_the_network():
    """With equal parameters: the first layer has equal neighbours, the later ones have not."""
    networks = {}
    for graph in ("fixed", "dynamic"):
        torch.manual_seed(1)
        networks[graph] = Dgcnn(width=8, embedding=16, k=6, scales=(0, 0), graph=graph).eval()
        assert networks[graph].settings["graph"] == graph
    parts = [dict(network.blocks.named_parameters()) for network in networks.values()]
    assert all(torch.equal(parts[0][name], parts[1][name]) for name in parts[0])
    seen = []

    def keep(module, given, output):
        seen.append(given[1])

    for network in networks.values():
        for block in network.blocks:
            block.conv.register_forward_hook(keep)
        with torch.inference_mode():
            network(*collate([_sphere(60, 4), _sphere(50, 5)]))
    fixed, dynamic = seen[:2], seen[2:]
    assert torch.equal(fixed[0], fixed[1]) and torch.equal(fixed[0], dynamic[0])
    assert not torch.equal(fixed[1], dynamic[1])
    assert dynamic[1][:60].max() < 60 <= dynamic[1][60:].min()  # spheres do not mix
    with pytest.raises(ValueError, match="unknown graph"):
        Dgcnn(graph="random")


def test_a_dynamic_network_learns():
    torch.manual_seed(3)
    network = Dgcnn(width=8, embedding=16, k=6, graph="dynamic")
    batch = collate([_sphere(60, 4), _sphere(50, 5)])
    targets = (batch[0][:, -1] > 0).long()
    optimizer = torch.optim.Adam(network.parameters(), 0.01)
    losses = []
    for _ in range(15):
        optimizer.zero_grad()
        loss = torch.nn.functional.nll_loss(network(*batch), targets)
        loss.backward()
        optimizer.step()
        losses.append(float(loss))
    assert losses[-1] < 0.5 * losses[0]


@pytest.mark.parametrize("graph", ["fixed", "dynamic"])
def test_weights_survive_a_round_trip(tmp_path, graph):
    torch.manual_seed(2)
    network = Dgcnn(width=8, embedding=16, scales=(0, 1), k=6, graph=graph).eval()
    save_weights(tmp_path / "w.pt", network, SAMPLING)
    again, sampling = load_weights(tmp_path / "w.pt")
    assert sampling == SAMPLING
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


def test_weights_that_do_not_tell_how_they_see_a_cloud_are_refused(tmp_path):
    told = SAMPLING | {"reference_height_m": 3.5}
    del told["sphere_points"]
    save_weights(tmp_path / "w.pt", Dgcnn(), told, {})
    cloud = PointCloud(np.random.default_rng(0).random((500, 3)))
    with pytest.raises(StageError, match="sphere_points.*w.pt.*segment.weights"):
        segment_cloud(cloud, tmp_path / "w.pt", sampling=Sampling())


def test_weights_of_other_classes_are_refused(tmp_path):
    network = Dgcnn()
    last = [module for module in network.modules() if isinstance(module, torch.nn.Linear)][-1]
    last.weight = torch.nn.Parameter(last.weight[:-1])
    save_weights(tmp_path / "w.pt", network, SAMPLING, {})
    with pytest.raises(StageError, match=f"do not fit the network of {N_CLASSES} classes"):
        load_weights(tmp_path / "w.pt")


def test_another_kind_of_torch_file_is_refused(tmp_path):
    torch.save({"state": {}}, tmp_path / "w.pt")
    with pytest.raises(StageError, match="not a file of segmentation weights"):
        load_weights(tmp_path / "w.pt")


def test_each_layer_looks_around_on_the_graph_of_its_own_scale():
    network, seen = Dgcnn(width=8, embedding=16, k=6).eval(), []
    for block in network.blocks:
        block.conv.register_forward_hook(lambda module, given, output: seen.append(given[1]))
    features, graphs, sizes = collate([_sphere(300, 2)])
    with torch.inference_mode():
        network(features, graphs, sizes)
    assert network.settings["scales"] == [0, 0, 1, 2]
    for neighbors, scale in zip(seen, (0, 0, 1, 2), strict=True):
        assert [torch.equal(neighbors, graph) for graph in graphs] == [
            scale == other for other in range(3)
        ]


def test_chances_sum_to_one_however_often_a_point_is_seen():
    sampling = Sampling(sphere_radius_m=0.4, sphere_points=80)
    points = np.random.default_rng(0).random((300, 3))
    network = Dgcnn(width=8, embedding=16, k=6).eval()
    found = predict_spheres(network, points, None, sampling, seed=0)
    assert found.shape == (300, N_CLASSES)
    assert np.allclose(found.sum(axis=1), 1.0, atol=1e-5)
