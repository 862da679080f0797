"""Confusion matrix and the measures the paper reports (total IoU, F1 per class)."""

import numpy as np

from cherrypicker.classes import CHANNELS
from cherrypicker.segmentation.dgcnn import N_CLASSES


def confusion_matrix(truth, predicted):
    """Points by true class (rows) and predicted class (columns), (n_classes, n_classes) int64.

    Both are channels of the network, (n_points,) int. Rows whose truth is none of them (unlabelled)
    are left out. Raises a ValueError if the arrays differ in shape, or a prediction at a counted
    row is no class.
    """
    truth, predicted = np.asarray(truth, np.int64), np.asarray(predicted, np.int64)
    if truth.shape != predicted.shape:
        raise ValueError(f"truth {truth.shape} and predicted {predicted.shape} differ in shape")
    counted = (truth >= 0) & (truth < N_CLASSES)
    truth, predicted = truth[counted], predicted[counted]
    if len(predicted) and (predicted.min() < 0 or predicted.max() >= N_CLASSES):
        raise ValueError(f"predictions must lie in 0 .. {N_CLASSES - 1}")
    cells = np.bincount(truth * N_CLASSES + predicted, minlength=N_CLASSES**2)
    return cells.reshape(N_CLASSES, N_CLASSES)


def scores(confusion):
    """Measures of a confusion matrix (n_channels, n_channels), by channel of the network.

    They are ``accuracy``, ``total_iou`` (over all points at once), ``mean_iou`` (over the classes
    that occur in the truth), and ``classes``: name to ``iou``, ``precision``, ``recall``, ``f1``,
    ``n_points`` of the truth and ``n_false``, points found that are of another class. A measure
    without a denominator is None.

    A class that the truth lacks is none of the mean: a single false point would pull it down by a
    seventh, as much as missing a class that is there. What it takes still counts, in the IoU of the
    classes that the points belong to, and stands in ``n_false``.
    """
    confusion = np.asarray(confusion, np.float64)
    hit = np.diag(confusion)
    in_truth, in_prediction = confusion.sum(axis=1), confusion.sum(axis=0)
    union = in_truth + in_prediction - hit

    def ratio(part, whole):
        return float(part / whole) if whole > 0 else None

    classes = {}
    for c in range(len(confusion)):
        classes[CHANNELS[c].name.lower()] = {
            "iou": ratio(hit[c], union[c]),
            "precision": ratio(hit[c], in_prediction[c]),
            "recall": ratio(hit[c], in_truth[c]),
            "f1": ratio(2 * hit[c], in_truth[c] + in_prediction[c]),
            "n_points": int(in_truth[c]),
            "n_false": int(in_prediction[c] - hit[c]),
        }
    ious = [entry["iou"] for entry in classes.values() if entry["n_points"]]
    return {
        "accuracy": ratio(hit.sum(), confusion.sum()),
        "total_iou": ratio(hit.sum(), union.sum()),
        "mean_iou": float(np.mean(ious)) if ious else None,
        "classes": classes,
    }


def score_table(result):
    """One line of text a class, for logs and the model card."""
    lines = [f"{'class':<17}{'IoU':>7}{'prec.':>7}{'recall':>7}{'F1':>7}{'points':>10}"]
    for name, entry in result["classes"].items():
        cells = "".join(
            f"{'-' if entry[m] is None else format(entry[m], '.3f'):>7}"
            for m in ("iou", "precision", "recall", "f1")
        )
        lines.append(f"{name:<17}{cells}{entry['n_points']:>10,}")
    return "\n".join(lines)
