# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The pendulum merely stated, against its own transcription."""

import inspect
from pathlib import Path
import sys

import numpy as np
import pytest

FOLDER = Path(__file__).parents[3] / 'docs' / 'plants'


@pytest.fixture(autouse=True)
def _pages(monkeypatch):
    monkeypatch.setattr(sys, 'path', [str(FOLDER), *sys.path])


def test_as_quick_as_the_built_in_problem():
    import pendulum as page
    from tdm_planner.problems import PendulumStart

    start = PendulumStart(theta=np.pi)
    stated = page.StatedSwingUp(start=start).solve(deadline=120.0)
    own = page.built_in(start).solve(deadline=60.0)
    assert stated.verification.ok
    assert stated.cost == pytest.approx(own.cost, rel=0.03)
    np.testing.assert_allclose(stated.trajectory.states[-1], 0.0, atol=2e-2)
    assert np.abs(stated.trajectory.control('torque')).max() < page.STRONG.torque * (1 + 1e-4)


def test_it_takes_few_lines():
    import pendulum as page

    lines = inspect.getsource(page.StatedSwingUp).splitlines()
    assert len([line for line in lines if line.strip()]) < 60
