# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import pytest
from tdm_planner import set_up
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems import RobotFormation


def test_every_problem_is_prepared(monkeypatch: pytest.MonkeyPatch, capsys):
    prepared = []
    monkeypatch.setattr(RobotFormation, 'prepare', lambda self: prepared.append(self.name))
    monkeypatch.setattr(set_up, 'problem_names', lambda: ['robot_formation'])
    assert set_up.main() == 0
    assert prepared == ['robot_formation']
    assert 'kernels of robot_formation' in capsys.readouterr().out


def test_a_problem_that_cannot_be_prepared_is_named(monkeypatch: pytest.MonkeyPatch, capsys):
    def load(name: str) -> type[RobotFormation]:
        if name == 'theirs':
            raise InvalidProblem('its module is missing')
        return RobotFormation

    monkeypatch.setattr(set_up, 'load_problem', load)
    monkeypatch.setattr(set_up, 'problem_names', lambda: ['theirs', 'robot_formation'])
    assert set_up.main() == 1
    captured = capsys.readouterr()
    assert 'theirs cannot be prepared: its module is missing' in captured.err
    assert 'kernels of robot_formation' in captured.out
