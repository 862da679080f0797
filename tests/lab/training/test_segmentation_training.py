"""Training on simple shapes: it learns, resumes to the same bytes, and labels a cloud."""

import numpy as np
import pytest
import torch

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.pointcloud import PointCloud
from cherrypicker.segmentation.dgcnn import (
    N_CLASSES,
    Dgcnn,
    choose_device,
)
from cherrypicker.segmentation.inference import (
    Sampling,
    propagate,
    segment_cloud,
)
from cherrypicker_lab.training.segmentation.augment import Sample
from cherrypicker_lab.training.segmentation.random_props import NO_WOOD
from cherrypicker_lab.training.segmentation.schedule import Schedule
from cherrypicker_lab.training.segmentation.training import (
    IGNORED,
    STRAY,
    class_weights,
    measure,
    network_labels,
    train,
    wood_loss,
)
from cherrypicker_lab.training.segmentation.weights import save_weights

SAMPLING = Sampling(
    voxel_size_m=0.05,
    reference_height_m=3.5,
    sphere_radius_m=0.8,
    sphere_points=400,
)
SMALL = {"width": 16, "embedding": 16, "scales": (0, 1), "k": 8}


def _tree(seed):
    """Green ground, a brown stem, level boughs: classes that position and colour tell apart."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-1, 1, (3000, 2)), rng.normal(0, 0.01, 3000)])
    angle = rng.uniform(0, 2 * np.pi, 1500)
    stem = np.column_stack(
        [0.06 * np.cos(angle), 0.06 * np.sin(angle), rng.uniform(0.02, 1.2, 1500)]
    )
    boughs = rng.uniform([-0.9, -0.02, 1.2], [0.9, 0.02, 1.3], (1500, 3))
    labels = np.repeat([Label.GROUND, Label.TRUNK, Label.BRANCH], [3000, 1500, 1500])
    colors = np.where(labels[:, None] == Label.GROUND, [50, 130, 40], [110, 80, 60])
    return Sample(
        np.vstack([ground, stem, boughs]).astype(np.float32),
        colors.astype(np.uint8),
        labels.astype(np.uint8),
        np.where(labels == Label.GROUND, 255, 0).astype(np.uint8),
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    choose_device(1, 0)
    folder = tmp_path_factory.mktemp("training")
    schedule = Schedule(10, 8, 24, learning_rate=0.01, final_learning_rate=0.001)
    network, history = train(
        [_tree(seed) for seed in range(6)],
        schedule=schedule,
        sampling=SAMPLING,
        checkpoint=folder / "checkpoint.pt",
        network_settings=SMALL,
    )
    save_weights(folder / "w.pt", network, vars(SAMPLING))
    return network, history, folder / "w.pt"


def _cloud(seed=50, with_colors=True):
    sample = _tree(seed).as_float()
    colors = sample.colors if with_colors else None
    return PointCloud(sample.points + [10.0, -5.0, 3.0], colors=colors), sample.labels


def test_training_learns_and_holds_on_a_new_tree(trained):
    network, history, _ = trained
    assert history[-1]["loss"] < 0.6 * history[0]["loss"]
    result = measure(network, [_tree(99)], SAMPLING)
    assert result["color"]["accuracy"] > 0.85
    assert set(result) == {"color", "no_color"}


def test_resumed_training_equals_an_uninterrupted_one(tmp_path):
    choose_device(1, 0)
    samples = [_tree(seed) for seed in range(2)]
    schedule = Schedule(epochs=2, batch_spheres=4, spheres_per_cloud=6, average=0.9, warmup=3)
    options = {"schedule": schedule, "sampling": SAMPLING, "network_settings": SMALL}
    whole, _ = train(samples, checkpoint=tmp_path / "a.pt", **options)

    class Killed(Exception):
        pass

    import cherrypicker_lab.training.segmentation.training as module

    original, calls = module._train_epoch, []

    def dies_in_the_second_epoch(*arguments):
        calls.append(1)
        if len(calls) == 2:
            raise Killed
        return original(*arguments)

    module._train_epoch = dies_in_the_second_epoch
    try:
        with pytest.raises(Killed):
            train(samples, checkpoint=tmp_path / "b.pt", **options)
    finally:
        module._train_epoch = original
    resumed, history = train(samples, checkpoint=tmp_path / "b.pt", **options)
    assert [entry["epoch"] for entry in history] == [1, 2]
    for a, b in zip(whole.state_dict().values(), resumed.state_dict().values()):
        assert torch.equal(a, b)


def test_segmented_cloud_keeps_its_points_and_is_reproducible(trained):
    cloud, truth = _cloud()
    options = {"sampling": SAMPLING, "seed": 3}
    result, grown = segment_cloud(cloud, trained[2], **options)
    again, _ = segment_cloud(cloud, trained[2], **options)
    assert len(grown.owner) == len(cloud)
    assert np.array_equal(result.points, cloud.points)
    assert result["label"].dtype == np.uint8 and result["confidence"].dtype == np.float32
    assert result["confidence"].min() >= 0 and result["confidence"].max() <= 1
    assert np.array_equal(result["label"], again["label"])
    assert np.array_equal(result["confidence"], again["confidence"])
    assert (result["label"] == truth).mean() > 0.7


def test_a_cloud_without_colour_is_labelled(trained):
    cloud, truth = _cloud(with_colors=False)
    # By the network alone: a stem that is as straight and even as this one is a post to the limbs
    result, _ = segment_cloud(cloud, trained[2], sampling=SAMPLING, by="network")
    assert len(result) == len(cloud)
    assert (result["label"] == truth).mean() > 0.85


def test_a_cloud_without_wood_is_an_error_that_names_the_key(tmp_path):
    choose_device(1, 0)
    network = Dgcnn(**SMALL)
    last = network.head[-1]
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.eye(N_CLASSES)[Label.GROUND] * 9)  # whatever it sees is ground
    save_weights(tmp_path / "w.pt", network, vars(SAMPLING))
    options = {"sampling": SAMPLING}
    with pytest.raises(StageError, match=r"trunk or branch \(found: ground\).*segment.weights"):
        segment_cloud(_cloud()[0], tmp_path / "w.pt", **options)


def test_too_few_points_and_missing_weights_are_errors(trained, tmp_path):
    cloud = PointCloud(np.zeros((3, 3)))
    options = {"sampling": SAMPLING}
    with pytest.raises(StageError, match="too few to segment"):
        segment_cloud(cloud, trained[2], **options)
    with pytest.raises(StageError, match="segment.weights"):
        segment_cloud(cloud, tmp_path / "none.pt", **options)


def test_post_trains_as_itself_and_the_unlabelled_is_ignored():
    targets = network_labels(np.array([0, 1, 7, 255, 6, NO_WOOD], np.uint8))
    assert targets.tolist() == [0, 1, 7, IGNORED, 6, STRAY]


def test_rare_classes_weigh_more():
    weights = class_weights([_tree(0)])
    assert weights[Label.TRUNK] > weights[Label.GROUND]
    assert weights[Label.ROOF] == 1.0  # absent: neither more nor less


def test_no_training_data_is_an_error(tmp_path):
    with pytest.raises(StageError, match="train_segment.n_scenes"):
        train([], schedule=Schedule(), sampling=SAMPLING, checkpoint=tmp_path / "c.pt")


def test_propagation_weighs_the_nearest_most():
    sampled = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    spread = propagate(np.array([[0.1, 0, 0], [0.5, 0, 0]]), sampled, np.eye(2, dtype=np.float32))
    assert spread[0, 0] == pytest.approx(0.9, abs=1e-3)
    assert np.allclose(spread.sum(axis=1), 1.0, atol=1e-5)


def test_the_wood_loss_forgives_trunk_for_branch_more_than_trunk_for_ground():
    weights = torch.ones(N_CLASSES)
    targets = torch.tensor([int(Label.TRUNK)] * 4)

    def loss(label):
        share = torch.full((4, N_CLASSES), 0.01)
        share[:, label] = 0.94
        return float(wood_loss(share.log(), targets, weights))

    assert loss(Label.TRUNK) < 0.1
    assert loss(Label.TRUNK) < loss(Label.BRANCH) < 0.5 * loss(Label.GROUND)


def test_things_of_no_class_may_be_anything_but_wood():
    targets = torch.tensor([int(Label.GROUND), STRAY, STRAY, IGNORED])

    def loss(*labels):
        share = torch.full((4, N_CLASSES), 0.01)
        share[torch.arange(4), torch.tensor(labels)] = 0.94
        return float(wood_loss(share.log(), targets, torch.ones(N_CLASSES)))

    ground, sign, roof, branch, trunk = map(
        int, (Label.GROUND, Label.SIGN, Label.ROOF, Label.BRANCH, Label.TRUNK)
    )
    assert loss(ground, sign, ground, trunk) == pytest.approx(loss(ground, roof, roof, ground))
    assert loss(ground, branch, sign, ground) > loss(ground, sign, sign, ground) + 0.5
    assert loss(ground, branch, sign, ground) == pytest.approx(loss(ground, sign, trunk, branch))


def test_a_training_with_a_time_limit_stops_and_goes_on_from_given_weights(trained, tmp_path):
    weights = tmp_path / "start.pt"
    save_weights(weights, trained[0], vars(SAMPLING))
    schedule = Schedule(50, 4, 6, learning_rate=1e-9, final_learning_rate=1e-9, minutes=1e-4)
    network, history = train(
        [_tree(seed) for seed in range(4)],
        schedule=schedule,
        sampling=SAMPLING,
        checkpoint=tmp_path / "checkpoint.pt",
        start=weights,
    )
    assert len(history) < 50
    before, after = trained[0].state_dict(), network.state_dict()
    assert torch.allclose(before["embed.0.weight"], after["embed.0.weight"], atol=1e-6)


def test_the_rate_falls_as_asked_and_rises_at_first():
    schedule = Schedule(learning_rate=1e-2, final_learning_rate=1e-4)
    assert schedule.rate(0.5) == pytest.approx(1e-3)
    cosine = Schedule(learning_rate=1e-2, final_learning_rate=1e-4, course="cosine", warmup=10)
    assert cosine.rate(0.5) == pytest.approx(0.5 * (1e-2 + 1e-4))
    assert cosine.rate(1.5) == pytest.approx(1e-4)
    assert cosine.rate(0.0, 4) == pytest.approx(0.5e-2)
    assert cosine.rate(0.0, 10) == pytest.approx(1e-2)


def test_the_kept_weights_are_the_running_mean(tmp_path):
    choose_device(1, 0)
    options = {"sampling": SAMPLING, "network_settings": SMALL}
    samples = [_tree(0)]
    last = Schedule(1, 4, 12, learning_rate=0.01)
    mean = Schedule(1, 4, 12, learning_rate=0.01, average=0.5)
    plain, history = train(samples, schedule=last, checkpoint=tmp_path / "a.pt", **options)
    kept, _ = train(samples, schedule=mean, checkpoint=tmp_path / "b.pt", **options)
    content = torch.load(tmp_path / "b.pt", weights_only=True)
    assert history[-1]["n_batches"] == content["n_batches"] == 3
    name = "head.5.weight"
    assert torch.equal(content["network"][name], plain.state_dict()[name])
    assert torch.equal(content["average"]["module." + name], kept.state_dict()[name])
    assert not torch.equal(kept.state_dict()[name], plain.state_dict()[name])


def test_class_weights_without_balance_are_alike():
    sample = _tree(0)
    assert class_weights([sample], 0.0)[:3].tolist() == [1, 1, 1]
    assert class_weights([sample], 0.5)[Label.TRUNK] > class_weights([sample], 0.5)[Label.GROUND]
