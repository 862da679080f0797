"""Training of the sky network: data, splits, augmentation, resuming."""

import json
import logging

import cv2
import numpy as np
import pytest
import torch
from stage_run import run_stage

from cherrypicker.errors import StageError
from cherrypicker_lab.training.sky.augment import AugmentOptions, draw_sample
from cherrypicker_lab.training.sky.data import doubtful_pixels, load_photos, split_photos
from cherrypicker_lab.training.sky.metrics import Confusion
from cherrypicker_lab.training.sky.orchards import random_orchard
from cherrypicker_lab.training.sky.training import TrainOptions, save_weights, train_network

SMALL = {"batch_size": 3, "image_size_px": 64, "widths": (6, 8, 8), "max_side_px": 96}


@pytest.fixture
def folder(tmp_path):
    """Ten photos with a blue half above a brown one."""
    rng = np.random.default_rng(0)
    for kind in ("images", "masks"):
        (tmp_path / "set/part" / kind).mkdir(parents=True)
    for k in range(10):
        horizon = int(rng.integers(25, 70))
        image = np.full((80, 100, 3), (50, 80, 110), np.uint8)
        image[:horizon] = (230, 180, 120)  # BGR
        mask = np.zeros((80, 100), np.uint8)
        mask[:horizon] = 255
        cv2.imwrite(str(tmp_path / f"set/part/images/p{k}.jpg"), image)
        cv2.imwrite(str(tmp_path / f"set/part/masks/p{k}.png"), mask)
    return tmp_path / "set"


def test_photos_are_read_and_reduced(folder):
    photos = load_photos([str(folder)], 50)
    assert [p.name for p in photos[:2]] == ["set/p0.jpg", "set/p1.jpg"]
    assert photos[0].image.shape == (40, 50, 3) and photos[0].sky.shape == (40, 50)


def test_missing_things_are_named(folder, tmp_path):
    (folder / "part/masks/p3.png").unlink()
    with pytest.raises(StageError, match=r"p3\.jpg"):
        load_photos([str(folder)], 50)
    with pytest.raises(StageError, match=r"train_sky\.folders"):
        load_photos([str(tmp_path / "absent")], 50)
    (tmp_path / "empty").mkdir()
    with pytest.raises(StageError, match=r"train_sky\.folders"):
        load_photos([str(tmp_path / "empty")], 50)


def test_split_holds_out_runs_or_patterns(folder):
    photos = load_photos([str(folder)], 50)
    training, validation = split_photos(photos, 0.3, [], seed=4)
    held = [int(p.name[-5]) for p in validation]
    assert len(training) == 7 and held == list(range(held[0], held[0] + 3))
    training, validation = split_photos(photos, 0.3, ["set/p[01].jpg"], seed=4)
    assert [p.name for p in validation] == ["set/p0.jpg", "set/p1.jpg"]
    with pytest.raises(StageError, match="0 for validation"):
        split_photos(photos, 0.3, ["no such*"], seed=4)


def test_gaps_of_a_crown_are_doubtful_and_a_white_wall_is_not():
    image = np.full((200, 300, 3), 230, np.uint8)
    sky = np.zeros((200, 300), bool)
    sky[:150] = True
    sky[50:150, 100:200] = False  # the crown, drawn as one blob
    image[50:150:4, 100:200] = 60
    image[50:150:4, 102:198] = 60
    image[51:150:4, 100:200] = 60
    image[150:] = 90
    image[110:150, 220:290] = 228  # a wall
    sky[110:150, 220:290] = False
    doubtful = doubtful_pixels(image, sky)
    assert doubtful[52:148:4, 102:115].mean() > 0.6  # as far in as the sky around is known
    assert not doubtful[120:140, 235:275].any()
    assert not (doubtful & sky).any()


def test_samples_depend_on_the_generator_only(folder):
    photo = load_photos([str(folder)], 100)[0]
    drawn = [draw_sample(photo, 64, AugmentOptions(), np.random.default_rng(k)) for k in (5, 5, 6)]
    assert all(np.array_equal(a, b) for a, b in zip(drawn[0], drawn[1]))
    assert not np.array_equal(drawn[0][0], drawn[2][0])
    image, sky, weight = drawn[0]
    assert image.shape == (64, 64, 3) and image.dtype == np.uint8
    assert set(np.unique(sky)) <= {0.0, 1.0} and set(np.unique(weight)) <= {0.0, 1.0}


def test_an_orchard_hides_the_sky_where_it_covers_it():
    sky = np.tile(np.array([0.2, 0.5, 0.9], np.float32), (96, 128, 1))
    covers = []
    for seed in range(6):
        image, cover = random_orchard(np.random.default_rng(seed), sky)
        assert image.shape == sky.shape and image.min() >= 0 and image.max() <= 1
        assert np.allclose(image[cover == 0], sky[cover == 0])
        is_blue = image[..., 2] > image[..., 0] + 0.5
        assert is_blue[cover < 0.1].all() and is_blue[cover > 0.9].mean() < 0.05
        covers.append(cover)
    assert not np.array_equal(covers[0], covers[1])
    # sky is left between the twigs, and trees stand before it
    gaps, wood = (
        np.mean([(c[:40] < 0.35).mean() for c in covers]),
        max(c[:40].max() for c in covers),
    )
    assert 0.1 < gaps < 0.98 and wood > 0.9


def test_training_goes_on_from_given_weights(folder, tmp_path):
    training, validation = split_photos(load_photos([str(folder)], 100), 0.2, [], seed=0)
    first = train_network(
        training, validation, TrainOptions(epochs=1, samples_per_epoch=3, **SMALL)
    )[0]
    save_weights(tmp_path / "w.npz", first)
    start = {"epochs": 1, "samples_per_epoch": 3, "start_weights": str(tmp_path / "w.npz"), **SMALL}
    second = train_network(training, validation, TrainOptions(learning_rate=1e-9, **start))[0]
    assert torch.allclose(first.head.weight, second.head.weight, atol=1e-3)
    other = train_network(training, validation, TrainOptions(learning_rate=0.1, **start))[0]
    assert not torch.allclose(first.head.weight, other.head.weight, atol=1e-2)
    options = TrainOptions(learning_rate=0.1, start_share=1.0, **start)
    kept = train_network(training, validation, options)[0]
    assert torch.allclose(first.head.weight, kept.head.weight, atol=1e-3)


def test_f1_of_a_known_confusion():
    confusion = Confusion()
    confusion.add(np.array([[0.9, 0.9, 0.1, 0.1]]), np.array([[True, False, True, False]]))
    confusion.add(np.ones((1, 2)), np.ones((1, 2), bool))
    scores = confusion.summary()
    assert scores["f1_sky"] == pytest.approx(2 * 3 / (2 * 3 + 2))
    assert scores["f1_ground"] == pytest.approx(0.5)
    assert scores["accuracy"] == pytest.approx(4 / 6)


def test_training_learns(folder):
    torch.set_num_threads(1)
    training, validation = split_photos(load_photos([str(folder)], 100), 0.2, [], seed=0)
    plain = {"branch_fraction": 0, "exchange_fraction": 0, "color_fraction": 0}
    options = TrainOptions(epochs=5, learning_rate=1e-2, samples_per_epoch=24, **plain, **SMALL)
    _, history = train_network(training, validation, options)
    assert len(history["epochs"]) == 5
    assert history["epochs"][-1]["loss"] < 0.6 * history["epochs"][0]["loss"]
    assert history["validation"]["f1_sky"] > 0.9 and history["validation"]["f1_ground"] > 0.9
    rates = [epoch["learning_rate"] for epoch in history["epochs"]]
    assert rates[1] == pytest.approx(0.9 * rates[0])


def test_a_killed_training_goes_on_as_if_nothing_had_been(folder, tmp_path, caplog):
    torch.set_num_threads(1)
    training, validation = split_photos(load_photos([str(folder)], 100), 0.2, [], seed=0)

    def train(epochs, name):
        options = TrainOptions(epochs=epochs, learning_rate=1e-3, samples_per_epoch=6, **SMALL)
        return train_network(training, validation, options, tmp_path / name)[0].state_dict()

    whole = train(3, "whole.pt")
    train(1, "killed.pt")
    with caplog.at_level(logging.INFO):
        resumed = train(3, "killed.pt")
    assert "resuming after epoch 1 of 3" in caplog.text
    assert all(torch.equal(whole[k], resumed[k]) for k in whole)


def test_one_cycle_rises_and_falls(folder):
    torch.set_num_threads(1)
    training, validation = split_photos(load_photos([str(folder)], 100), 0.2, [], seed=0)
    options = TrainOptions(
        epochs=6, learning_rate=1e-2, schedule="one_cycle", samples_per_epoch=3, **SMALL
    )
    _, history = train_network(training, validation, options)
    rates = [epoch["learning_rate"] for epoch in history["epochs"]]
    assert rates[0] == pytest.approx(1e-3) and max(rates) == rates[1] <= 1e-2
    assert rates[1:] == sorted(rates[1:], reverse=True) and rates[-1] < 2e-3


def test_the_average_lags_behind_and_a_time_limit_loses_nothing(folder, tmp_path, caplog):
    torch.set_num_threads(1)
    training, validation = split_photos(load_photos([str(folder)], 100), 0.2, [], seed=0)

    def train(name, **changes):
        settings = {"weight_average": 0.9, "schedule": "one_cycle", "learning_rate": 1e-2}
        options = TrainOptions(epochs=2, samples_per_epoch=6, **{**SMALL, **settings, **changes})
        return train_network(training, validation, options, tmp_path / name)[0].state_dict()

    whole, last = train("whole.pt"), train("last.pt", weight_average=0.0)
    assert not torch.equal(whole["head.weight"], last["head.weight"])
    with caplog.at_level(logging.WARNING):
        train("short.pt", time_limit_min=1e-6)
    assert "time limit ends the training after epoch 1" in caplog.text
    resumed = train("short.pt")
    assert all(torch.equal(whole[key], resumed[key]) for key in whole)


def test_a_foreign_checkpoint_is_not_used(folder, tmp_path, caplog):
    training, validation = split_photos(load_photos([str(folder)], 100), 0.2, [], seed=0)
    options = TrainOptions(epochs=1, samples_per_epoch=3, **SMALL)
    train_network(training, validation, options, tmp_path / "c.pt")
    (tmp_path / "d.pt").write_bytes(b"junk")
    other = TrainOptions(epochs=1, samples_per_epoch=3, seed=9, **SMALL)
    with caplog.at_level(logging.INFO):
        train_network(training, validation, other, tmp_path / "c.pt")
        train_network(training, validation, other, tmp_path / "d.pt")
    assert "starting afresh" in caplog.text and "unreadable" in caplog.text


def test_the_script_keeps_its_checkpoint_after_the_time_limit_only(folder, tmp_path):
    given = {"folders": [str(folder)], "exclude": ["set/p[12].jpg"], "threads": 1, "epochs": 2}
    given |= {"weights": tmp_path / "w.npz", "metrics": tmp_path / "m.json"}
    given |= {"samples_per_epoch": 3, "image_size_px": 64}
    run_stage("train_sky", **given, time_limit_min=1e-6)
    metrics = json.loads((tmp_path / "m.json").read_text())
    assert len(metrics["epochs"]) == 1 and metrics["n_training"] + metrics["n_validation"] == 8
    assert (tmp_path / "checkpoint.pt").is_file()
    run_stage("train_sky", **given)
    assert len(json.loads((tmp_path / "m.json").read_text())["epochs"]) == 2
    assert not (tmp_path / "checkpoint.pt").exists()


def test_the_colours_of_a_sky_change_from_sample_to_sample(folder):
    photo = load_photos([str(folder)], 100)[0]
    still = {"branch_fraction": 0.0, "exchange_fraction": 0.0}

    def spread(options):
        skies = []
        for seed in range(24):
            image, sky, _ = draw_sample(photo, 64, options, np.random.default_rng(seed))
            if sky.mean() > 0.1:
                skies.append(np.median(image[sky > 0], axis=0))
        assert len(skies) > 12
        return np.std(skies, axis=0).max()

    assert spread(AugmentOptions(**still, color_fraction=0.0)) < 5
    assert spread(AugmentOptions(**still)) > 15
