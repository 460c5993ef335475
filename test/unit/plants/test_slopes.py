# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives that CasADi writes down, against differences, and where their text is kept."""

from __future__ import annotations

import inspect
from pathlib import Path
import shutil
from typing import Any, NamedTuple

from differences import central
import numpy as np
import pytest
from tdm_planner.plants import slopes
from tdm_planner.tracking.estimator import EstimatedPendulum


def test_kernels_are_recompiled_where_the_sources_of_this_version_change_only(tmp_path):
    """Not for files that an earlier version left; an estimator's equations once were kept."""
    installed = tmp_path / 'tdm_planner'
    shutil.copytree(Path(slopes.__file__).parents[1], installed)
    sources = slopes._sources(installed)
    assert len(sources) > 15
    assert Path(inspect.getfile(EstimatedPendulum)).read_bytes() in sources
    (installed / 'problems' / 'stale.py').write_text('@compiled\ndef stale(): ...\n')
    assert slopes._sources(installed) == sources
    with (installed / 'problems/formation/polynomial_kernels.py').open('a') as kernel:
        kernel.write('# changed\n')
    assert slopes._sources(installed) != sources


class Pair(NamedTuple):
    first: float
    second: float


def stated(k: Pair, states: list[Any], x: Any) -> tuple[Any, ...]:
    a, b = states
    first = k.first * np.sin(a * b) - x / (2.0 + np.cos(b)) ** 2
    return first, 1.0 / (k.second + a * a) + 2.0 * b, b


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    slopes.with_slopes.cache_clear()
    monkeypatch.setattr(slopes, 'FOLDER', tmp_path)
    return tmp_path


def derived() -> Any:
    return slopes.with_slopes(stated, ('states', 'x'), k=Pair, states=2)


def test_values_and_slopes_are_those_of_the_function_for_numbers_and_arrays() -> None:
    k, at = Pair(0.7, 1.3), np.array([0.4, -0.8, 2.0])
    found = np.array(derived()(k, at[:2], at[2])).reshape(4, 3)
    np.testing.assert_allclose(found[0], stated(k, list(at[:2]), at[2]), rtol=1e-14)
    slopes = central(lambda x: stated(k, list(x[:2]), x[2]), at)
    np.testing.assert_allclose(found[1:].T, slopes, atol=1e-8)
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
