"""Skeletons as networkx graphs, and folded by networkx as by ourselves."""

import networkx as nx
import numpy as np
import pytest

from cherrypicker.skeleton import (
    Skeleton,
    axes,
    fold,
    node_order,
    write_topology_graphml,
)
from cherrypicker.skeleton.networks import as_networkx, folded


@pytest.fixture
def skeleton():
    """A stem with two laterals, one of which forks, and a lateral at the root."""
    rng = np.random.default_rng(0)
    parent = np.array([-1, 0, 1, 2, 3, 4, 2, 6, 7, 8, 7, 10, 0, 12])
    points = rng.normal(size=(len(parent), 3))
    fields = {"gap": np.arange(len(parent)) % 2, "n_points": np.arange(len(parent))}
    return Skeleton(points, parent, rng.random(len(parent)), np.ones(len(parent)), fields)


def test_a_skeleton_is_a_tree_of_its_nodes(skeleton):
    graph = as_networkx(skeleton)
    assert nx.is_tree(graph) and list(graph.nodes) == list(range(len(skeleton)))
    assert graph.graph == {"root": "0", "unit": "m", "frame": "metric"}
    assert graph.nodes[7]["x"] == skeleton.points[7, 0] and graph.nodes[7]["n_points"] == 7
    assert graph.edges[3, 2] == {"length": skeleton.edge_length[3], "gap": 1}


def test_folding_leaves_root_junctions_and_tips(skeleton, tmp_path):
    order = node_order(skeleton, axes(skeleton))
    graph = folded(skeleton, order)
    assert {node for node, degree in graph.degree if degree == 2} <= {0}
    write_topology_graphml(tmp_path / "topology.graphml", skeleton, order)
    found, ours = nx.read_graphml(tmp_path / "topology.graphml"), fold(skeleton)
    assert set(found) == set(map(str, ours.nodes))
    for node, point, kind in zip(ours.nodes, ours.points, ours.kind, strict=True):
        assert found.nodes[str(node)] == {**dict(zip("xyz", point, strict=True)), "kind": kind}
    assert (found.graph["unit"], found.graph["frame"]) == (ours.unit, ours.frame)
    assert len(found.edges) == len(ours.edges)
    for edge in ours.edges:
        one = found.edges[str(edge.parent), str(edge.child)]
        assert one["path"] == " ".join(map(str, edge.path))
        for name in ("radius_start", "radius_end", "order"):
            assert one[name] == getattr(edge, name), name
        assert one["length"] == pytest.approx(edge.length)
