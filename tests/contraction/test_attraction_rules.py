"""How W_H grows: by hand for each rule, and against pc-skeletor itself."""

import os

import numpy as np
import pytest
from pc_skeletor_reference import METHODS, REFERENCE, STEPS, peer_steps, reference_cloud

from cherrypicker.contraction.contract_points import (
    ATTRACTION_RULES,
    SkeletonOptions,
    contract_points,
)
from cherrypicker.contraction.laplacian_published import cotangent_laplacian, solve_contraction
from cherrypicker.errors import StageError

PEER_PYTHON = os.environ.get("CHERRYPICKER_PEER_PYTHON")


@pytest.fixture(scope="module")
def cloud():
    return reference_cloud()


def after(cloud, method, rule, n):
    weights = np.where(cloud["label"] == 1, 10.0, 1.0) if method == "slbc" else None
    options = SkeletonOptions("slbc", attraction_rule=rule, max_iterations=n)
    return contract_points(cloud.points, weights, options).points


@pytest.mark.parametrize("rule", ATTRACTION_RULES)
def test_three_iterations_by_hand(cloud, rule):
    points = cloud.points - cloud.points.mean(axis=0)
    L, first = cotangent_laplacian(points)
    w_l, w_h, masses = 1000 * np.sqrt(first.mean()), np.full(len(points), 0.5), [first]
    for _ in range(3):
        points = solve_contraction(L, np.full(len(points), w_l), w_h, points)
        L, mass = cotangent_laplacian(points)
        masses.append(mass)
        grown = {
            "compound": w_h * np.sqrt(first / mass),
            "pc_skeletor": w_h * np.sqrt(first / masses[-2]),
            "cao": 0.5 * np.sqrt(first / mass),
        }[rule]
        w_l, w_h = min(2 * w_l, 2048), np.clip(grown, 0.1, 1024)
    found = after(cloud, "lbc", rule, 3) - cloud.points.mean(axis=0)
    np.testing.assert_allclose(found, points, atol=1e-9)


def test_an_unknown_rule_is_refused():
    with pytest.raises(StageError, match="skeleton.attraction_rule"):
        SkeletonOptions("slbc", attraction_rule="squared")


def assert_equal_steps(cloud, steps):
    for method in METHODS:
        for n in STEPS:
            found = after(cloud, method, "pc_skeletor", n)
            np.testing.assert_allclose(found, steps[f"{method}_{n}"], atol=1e-6)  # m


def test_pc_skeletors_rule_gives_pc_skeletors_points(cloud):
    with np.load(REFERENCE, allow_pickle=False) as steps:
        assert_equal_steps(cloud, steps)
        for rule in ("compound", "cao"):
            other = after(cloud, "lbc", rule, 2)
            assert np.median(np.linalg.norm(other - steps["lbc_2"], axis=1)) > 1e-3


@pytest.mark.skipif(not PEER_PYTHON, reason="$CHERRYPICKER_PEER_PYTHON has pc-skeletor, if set")
def test_pc_skeletor_itself_gives_its_points(cloud):
    assert_equal_steps(cloud, peer_steps(PEER_PYTHON))
