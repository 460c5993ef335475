# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives that CasADi writes down, against differences, and where their text is kept."""

from __future__ import annotations

import inspect
from pathlib import Path
import shutil
from typing import Any, NamedTuple

import numpy as np
import pytest
from tdm_planner.plants import slopes
from tdm_planner.tracking.estimator import EstimatedPendulum


def test_files_that_an_earlier_version_left_in_an_installation_do_not_recompile_kernels(tmp_path):
    installed = tmp_path / 'tdm_planner'
    shutil.copytree(Path(slopes.__file__).parents[1], installed)
    sources = slopes._sources(installed)
    assert len(sources) > 15
    (installed / 'problems' / 'stale.py').write_text('@compiled\ndef stale(): ...\n')
    assert slopes._sources(installed) == sources
    with (installed / 'problems/formation/polynomial_kernels.py').open('a') as kernel:
        kernel.write('# changed\n')
    assert slopes._sources(installed) != sources


def test_derivatives_are_written_anew_where_the_equations_of_an_estimator_change() -> None:
    """They were kept, with the shapes of another version."""
    equations = Path(inspect.getfile(EstimatedPendulum)).read_bytes()
    assert equations in slopes._sources(Path(slopes.__file__).parents[1])


class Pair(NamedTuple):
    first: float
    second: float


def stated(k: Pair, states: list[Any], x: Any) -> tuple[Any, ...]:
    a, b = states
    return (
        k.first * np.sin(a * b) - x / (2.0 + np.cos(b)) ** 2,
        1.0 / (k.second + a * a) + 2.0 * b,
        b,
    )


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    slopes.with_slopes.cache_clear()
    monkeypatch.setattr(slopes, 'FOLDER', tmp_path)
    return tmp_path


def derived() -> Any:
    return slopes.with_slopes(stated, ('states', 'x'), k=Pair, states=2)


def test_values_and_slopes_are_those_of_the_function_for_numbers_and_arrays() -> None:
    k, at, h = Pair(0.7, 1.3), np.array([0.4, -0.8, 2.0]), 1e-6
    found = np.array(derived()(k, at[:2], at[2])).reshape(4, 3)
    np.testing.assert_allclose(found[0], stated(k, list(at[:2]), at[2]), rtol=1e-14)
    for row, step in zip(found[1:], h * np.eye(3), strict=True):
        ahead, behind = at + step, at - step
        change = np.subtract(
            stated(k, list(ahead[:2]), ahead[2]), stated(k, list(behind[:2]), behind[2])
        )
        np.testing.assert_allclose(row, change / (2 * h), atol=1e-8)
    many = derived()(k, np.tile(at[:2, None], 5), np.full(5, at[2]))
    np.testing.assert_allclose(many[0], np.full(5, found[0, 0]), rtol=1e-14)


@pytest.mark.parametrize('writable', [True, False])
def test_the_text_is_written_once_where_that_is_allowed(folder, monkeypatch, writable):
    if not writable:
        monkeypatch.setattr(slopes, 'FOLDER', folder / 'none')
    before = derived()(Pair(0.7, 1.3), [0.4, -0.8], 2.0)
    assert len(list(folder.iterdir())) == writable
    slopes.with_slopes.cache_clear()
    if writable:
        monkeypatch.setattr(slopes, '_text', None)
    assert derived()(Pair(0.7, 1.3), [0.4, -0.8], 2.0) == before
