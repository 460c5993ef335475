# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from pathlib import Path

import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.registry import load_problem, problem_names


@pytest.fixture
def registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Another package's registration, as pip leaves it on the path."""
    metadata = tmp_path / 'another-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text('Metadata-Version: 2.1\nName: another\nVersion: 1.0\n')
    (metadata / 'entry_points.txt').write_text(
        '[tdm_planner.problems]\n'
        'another = another_package:Another\n'
        'a_function = another_package:solve\n'
        'nothing = another_package:Missing\n'
        'broken = broken_package:Another\n'
    )
    (tmp_path / 'another_package.py').write_text(
        'from tdm_planner.problems import PendulumSwingUp\n'
        'class Another(PendulumSwingUp):\n'
        '    name = "another"\n'
        'def solve(): pass\n'
    )
    (tmp_path / 'broken_package.py').write_text('1 / 0\n')
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_the_packages_own_and_another_packages(registered: Path) -> None:
    assert load_problem('pendulum_swing_up') is PendulumSwingUp
    assert problem_names()[:2] == ['pendulum_swing_up', 'robot_formation']
    assert load_problem('another').name == 'another'
    assert {'another', 'broken'} <= set(problem_names())


@pytest.mark.parametrize(
    ('name', 'says'),
    [
        ('anothr', r"parameter 'problem' = 'anothr' .* \(did you mean another\?\)"),
        ('zzz', "'zzz' is not allowed: must be one of pendulum_swing_up, robot_formation"),
        ('a_function', 'another_package:solve is not a subclass'),
        ('nothing', 'AttributeError'),
        ('broken', 'ZeroDivisionError: division by zero'),
    ],
)
def test_what_cannot_be_loaded(registered: Path, name: str, says: str) -> None:
    with pytest.raises(InvalidProblem, match=says):
        load_problem(name)
