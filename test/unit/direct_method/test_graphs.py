# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Graphs of limits without the kinks that only fold them, and of rates with rounded kinks."""

import casadi as ca
import numpy as np
import pytest
from tdm_planner.direct_method.graphs import Rounded, Unfolded

NUMBERS = np.array([2.0])  # p: a limit


@pytest.mark.parametrize(
    ('limit', 'rows'),
    [
        (lambda t, x, u, p: p - np.abs(u[0]), 2),
        (lambda t, x, u, p: 1.0 - np.abs(u[0] * x[1]) / p, 2),
        (lambda t, x, u, p: np.minimum(x[0] - t, np.minimum(x[1], u[0])), 3),
        (lambda t, x, u, p: p - np.maximum(np.abs(x[0]), np.abs(u[1])), 4),
        (lambda t, x, u, p: p - np.abs(x[0]) - np.abs(x[1]), 4),
        # The greater branch would do, and a slope that depends on the motion: the kink stays.
        (lambda t, x, u, p: np.abs(x[0]) - p, 1),
        (lambda t, x, u, p: np.maximum(x[0], x[1]) - p, 1),
        (lambda t, x, u, p: p - x[0] * np.abs(u[0]), 1),
        (lambda t, x, u, p: p - np.abs(np.abs(x[0]) - 1.0), 3),
        (lambda t, x, u, p: p - x[0] ** 2, 1),
    ],
)
def test_the_least_row_is_the_limit(limit, rows) -> None:
    t, x, u, p = (ca.SX.sym(name, size) for name, size in (('t', 1), ('x', 2), ('u', 2), ('p', 1)))
    both = ca.vertcat(1.0 + x[1], limit(t, ca.vertsplit(x), ca.vertsplit(u), p))
    margins = ca.Function('margins', [t, x, u, p], [both])
    found = Unfolded(margins, NUMBERS)
    assert found.limit.tolist() == [0] + [1] * rows
    rng = np.random.default_rng(3)
    for _ in range(50):
        at = rng.normal(), rng.normal(size=2), 2.0 * rng.normal(size=2), NUMBERS
        least, wanted = (np.array(function(*at)).ravel() for function in (found.rows, margins))
        assert [least[found.limit == k].min() for k in (0, 1)] == pytest.approx(wanted)


def test_many_kinks_do_not_multiply_without_end() -> None:
    x = ca.SX.sym('x', 20)
    one = [ca.SX.sym('t'), x, ca.SX.sym('u'), ca.SX.sym('p')]
    margins = ca.Function('margins', one, [1.0 - ca.sum1(ca.fabs(x))])
    found = Unfolded(margins, NUMBERS)
    assert found.limit.size <= 64
    at = 0.0, np.linspace(-0.1, 0.1, 20), 0.0, NUMBERS
    assert float(np.min(found.rows(*at))) == pytest.approx(float(margins(*at)))


def test_numbers_that_turn_a_fold_round_unfold_anew() -> None:
    t, x, u, p = (ca.SX.sym(name) for name in 'txup')
    margins = ca.Function('margins', [t, x, u, p], [x + p * (1.0 - ca.fabs(u))])
    found = Unfolded(margins, np.array([2.0]))
    assert found.limit.tolist() == [0, 0]
    assert found.decides_alike(np.array([0.1]))
    assert not found.decides_alike(np.array([-2.0]))
    assert Unfolded(margins, np.array([-2.0])).limit.tolist() == [0]


def test_kinks_within_kinks_are_rounded_and_measured() -> None:
    x, p = ca.SX.sym('x', 2), ca.SX.sym('p')
    stated = ca.sqrt(ca.fmax(x[0] - p, ca.fabs(x[1])))
    rounded = Rounded(ca.Function('stated', [x, p], [stated]))
    assert rounded.count == 3
    at = [3.0, -0.5], 2.0
    sizes = np.array(rounded.sizes(*at)).ravel()
    # |x1|, the difference, the root
    assert sorted(np.abs(sizes)) == pytest.approx([0.5, 0.5, 1.0])
    exact, near = (float(rounded.value(*at, e)) for e in (np.zeros(3), np.full(3, 1e-3)))
    assert exact == pytest.approx(1.0)
    assert near == pytest.approx(exact, abs=1e-4)
    slopes = ca.Function('slopes', [x, p], [ca.jacobian(rounded.value(x, p, np.full(3, 1e-3)), x)])
    assert np.isfinite(np.array(slopes([2.0, 0.0], 2.0))).all()
