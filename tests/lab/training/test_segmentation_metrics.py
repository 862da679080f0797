"""Confusion matrix and measures on counts worked out by hand."""

import numpy as np
import pytest

from cherrypicker_lab.training.segmentation.metrics import confusion_matrix, score_table, scores


def test_scores_of_a_small_case():
    truth = np.array([0, 0, 0, 1, 1, 2, 255])
    predicted = np.array([0, 0, 1, 1, 2, 2, 0])
    confusion = confusion_matrix(truth, predicted)
    assert confusion.sum() == 6  # the unlabelled point does not count
    result = scores(confusion)
    assert result["classes"]["ground"]["iou"] == pytest.approx(2 / 3)
    assert result["classes"]["trunk"]["precision"] == pytest.approx(1 / 2)
    assert result["classes"]["trunk"]["recall"] == pytest.approx(1 / 2)
    assert result["classes"]["branch"]["f1"] == pytest.approx(2 / 3)
    assert result["classes"]["roof"]["f1"] is None
    assert result["total_iou"] == pytest.approx(4 / 8)
    assert result["mean_iou"] == pytest.approx((2 / 3 + 1 / 3 + 1 / 2) / 3)
    assert "branch" in score_table(result)


def test_perfect_prediction_scores_one():
    labels = np.arange(7).repeat(3)
    result = scores(confusion_matrix(labels, labels))
    assert result["mean_iou"] == result["accuracy"] == result["total_iou"] == 1.0


def test_a_class_that_the_truth_lacks_is_none_of_the_mean():
    truth = np.array([0] * 8 + [1] * 4)
    predicted = np.array([0] * 6 + [6] * 2 + [1] * 4)  # two points of ground called roof
    result = scores(confusion_matrix(truth, predicted))
    assert result["mean_iou"] == pytest.approx((6 / 8 + 1) / 2)
    assert result["classes"]["roof"] == {
        "iou": 0.0, "precision": 0.0, "recall": None, "f1": 0.0, "n_points": 0, "n_false": 2,
    }  # fmt: skip


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="differ in shape"):
        confusion_matrix(np.zeros(3), np.zeros(4))
    with pytest.raises(ValueError, match="must lie in"):
        confusion_matrix(np.zeros(3), np.full(3, 9))
