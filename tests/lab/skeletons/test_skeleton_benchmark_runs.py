"""The benchmark of skeletons: its clouds, its runs, the peer's faults, its tables."""

import json
import sys

import numpy as np
import pytest
from skeleton_shapes import labelled_cloud, small_tree

from cherrypicker.errors import StageError
from cherrypicker.skeleton.model import Skeleton
from cherrypicker_lab.skeletons import peer
from cherrypicker_lab.skeletons.methods import measure_cloud
from cherrypicker_lab.skeletons.tables import gather, write_tables
from cherrypicker_lab.skeletons.true_tree import TrueTree


def true_small_tree(axes):
    """The true skeleton of `small_tree`, nodes every 5 cm, its twig an order of its own."""
    nodes, parent, radius, order = [], [], [], []
    for foot, top, base, tip, label in axes:
        start, end = np.asarray(foot, float), np.asarray(top, float)
        n = max(2, int(np.linalg.norm(end - start) / 0.05))
        for k in range(0 if not nodes else 1, n + 1):
            place = start + (end - start) * k / n
            if k == 0:
                parent.append(-1)
            elif k == 1 and len(nodes) > 1:
                parent.append(int(np.argmin(np.linalg.norm(np.array(nodes) - start, axis=1))))
            else:
                parent.append(len(nodes) - 1)
            nodes.append(place)
            radius.append(base + (tip - base) * k / n)
            order.append(label - 1 + (base == 0.007))
    labels = np.minimum(np.array(order) + 1, 2)
    return Skeleton(np.array(nodes), np.array(parent), radius, labels, {"order": np.array(order)})


@pytest.fixture(scope="module")
def scene():
    points, labels, axes = small_tree(noise=0.001)
    return labelled_cloud(points, labels), TrueTree(true_small_tree(axes))


@pytest.fixture(scope="module")
def measured(scene):
    return measure_cloud(*scene, ["bare_default", "slbc_default"])


def test_a_cloud_is_contracted_connected_and_scored(measured):
    found = measured["slbc_default"]
    assert found["points"]["chamfer_cm2"] < 1 and found["cpu_s"] > 0
    assert set(found["graphs"]) == {"mst", "tree"}
    assert found["graphs"]["tree"]["ways_within_10pct"] > 0.9
    assert abs(found["graphs"]["tree"]["radius"]["above_12mm"]) < 0.001
    bare = measured["bare_default"]["graphs"]
    assert set(bare) == {"tree"} and bare["tree"]["ways_within_10pct"] > 0.9
    json.dumps(measured)


def scores_file(path, tree, template, settings):
    path.write_text(json.dumps({"tree": tree, "template": template, "settings": settings}))
    return path


def test_tables_hold_means(tmp_path, measured):
    base = measured["slbc_default"]

    def with_chamfer(value):
        return base | {"points": base["points"] | {"chamfer_cm2": value}}

    files = [
        scores_file(tmp_path / "a.json", "fir_00", "fir",
                    {"noise": {"lbc_paper": with_chamfer(4.0), "slbc_paper": with_chamfer(2.0)}}),
        scores_file(tmp_path / "b.json", "pine_02", "pine",
                    {"noise": {"lbc_paper": with_chamfer(6.0), "slbc_paper": with_chamfer(3.0)}}),
        scores_file(tmp_path / "c.json", "fir_00", "fir",
                    {"noise": {"slbc_default": with_chamfer(0.5)}}),
    ]  # fmt: skip
    text = write_tables(gather(files))
    # two trees of the published LBC, one of them common to all methods
    assert "| noise | LBC | 2 | 5.000 | 4.000 |" in text
    assert "| noise | limbs | 1 | 0.500 | 0.500 |" in text
    assert "| limbs |" in text and "spanning tree" in text
    with pytest.raises(StageError, match="nothing was measured"):
        gather([])


def test_a_peer_that_is_not_there_or_fails_names_the_key(tmp_path, scene):
    cloud, _ = scene
    with pytest.raises(StageError, match="cannot be started") as error:
        peer.run_peer(tmp_path / "no-python", cloud, "lbc")
    assert error.value.key == "benchmark.skeleton.peer_python"
    with pytest.raises(StageError, match="pc-skeletor fails"):
        peer.run_peer(sys.executable, cloud, "lbc")  # this Python has no pc_skeletor
    with pytest.raises(StageError, match="PyTLidar fails") as error:
        peer.run_pytlidar(sys.executable, cloud)
    assert error.value.key == "benchmark.skeleton.pytlidar_python"


def test_a_method_that_fails_on_a_cloud_is_reported_and_the_other_kept(scene, monkeypatch):
    cloud, truth = scene

    def run(python, cloud, method):
        if method == "slbc":
            raise peer.PeerFailedError("pc-skeletor fails (NaN)")
        skeleton = {"contracted": cloud.points[:3], "nodes": cloud.points[:3]}
        skeleton["edges"] = np.array([[0, 1], [1, 2]])
        return skeleton, {"cpu_s": 1.0, "graph_cpu_s": 1.0, "peak_mb": 1.0, "version": "1.0.0"}

    with pytest.raises(StageError, match="pc-skeletor fails"):
        peer.measure_peer(sys.executable, cloud, truth)  # both of them: it has no pc_skeletor
    monkeypatch.setattr(peer, "run_peer", run)
    report = peer.measure_peer("python", cloud, truth)
    assert report["peer_slbc"] == {"failed": "pc-skeletor fails (NaN)"}
    assert report["peer_lbc"]["cpu_s"] == 1.0


def test_pytlidars_cylinders_are_read_and_scored(tmp_path, scene, monkeypatch):
    cloud, truth = scene
    stand_in = tmp_path / "stand_in.py"
    stand_in.write_text(
        "import argparse, json, numpy as np\n"
        "parser = argparse.ArgumentParser()\n"
        "for name in ('cloud', 'cylinders', 'report'):\n"
        "    parser.add_argument('--' + name)\n"
        "given = parser.parse_args()\n"
        "points = np.load(given.cloud)['points']\n"
        "foot, top = points[points[:, 2].argmin()], points[points[:, 2].argmax()]\n"
        "model = dict(start=[foot], end=[top], radius=[0.03], parent=[-1], branch=[0])\n"
        "np.savez(given.cylinders, **model)\n"
        "details = dict(cpu_s=2.0, peak_mb=100.0, version='1', patches_m={'PatchDiam1': 0.02})\n"
        "json.dump(details, open(given.report, 'w'))\n"
    )
    monkeypatch.setattr(peer, "PYTLIDAR_RUNNER", stand_in)
    found = peer.measure_pytlidar(sys.executable, cloud, truth)["peer_pytlidar"]
    assert found["cpu_s"] == 2.0 and found["patches_m"] == {"PatchDiam1": 0.02}
    assert found["graphs"]["own"]["junctions"]["n_found"] == 0
    assert found["graphs"]["own"]["radius"]["above_12mm"] > 0


def test_the_peers_results_are_read_and_scored(tmp_path, scene, monkeypatch):
    cloud, truth = scene
    stand_in = tmp_path / "stand_in.py"
    stand_in.write_text(
        "import argparse, json, numpy as np\n"
        "parser = argparse.ArgumentParser()\n"
        "for name in ('cloud', 'method', 'weight', 'max_iterations', 'skeleton', 'report'):\n"
        "    parser.add_argument('--' + name)\n"
        "given = parser.parse_args()\n"
        "points = np.load(given.cloud)['points']\n"
        "chain = np.column_stack([np.arange(len(points) - 1), np.arange(1, len(points))])\n"
        "np.savez(given.skeleton, contracted=points, nodes=points, edges=chain)\n"
        "details = dict(cpu_s=2.0, graph_cpu_s=0.5, peak_mb=100.0, version='1.0.0')\n"
        "json.dump(details, open(given.report, 'w'))\n"
    )
    monkeypatch.setattr(peer, "RUNNER", stand_in)
    few = cloud.select(np.arange(0, len(cloud), 50))
    report = peer.measure_peer(sys.executable, few, truth)
    assert set(report) == {"peer_lbc", "peer_slbc"}
    assert report["peer_lbc"]["cpu_s"] == 2.0
    assert report["peer_slbc"]["graphs"]["own"]["n_false_edges"] > 5
