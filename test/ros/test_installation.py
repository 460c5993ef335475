# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import importlib.machinery
import importlib.util
from pathlib import Path
import sys

import pytest
from tdm_planner.nodes.installation import (
    MixedInstallations,
    native_prefixes,
    require_one_ros,
)


@pytest.fixture
def sourced(tmp_path: Path) -> dict[str, str]:
    (tmp_path / 'opt/ros/lib/python3.12/site-packages/rclpy').mkdir(parents=True)
    (tmp_path / 'workspace').mkdir()
    return {'AMENT_PREFIX_PATH': f'{tmp_path}/workspace:{tmp_path}/opt/ros'}


@pytest.fixture
def wheels(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    spec = importlib.machinery.ModuleSpec('x', None) if request.param else None
    monkeypatch.setattr(importlib.util, 'find_spec', lambda name: spec)


def test_only_prefixes_with_an_rclpy_count(sourced: dict[str, str], tmp_path: Path) -> None:
    assert native_prefixes(sourced) == [f'{tmp_path}/opt/ros']
    assert native_prefixes({}) == []


@pytest.mark.parametrize('wheels', [True], indirect=True)
def test_wheels_beside_a_sourced_installation_are_refused(
    sourced: dict[str, str], wheels: None, tmp_path: Path
) -> None:
    with pytest.raises(MixedInstallations) as error:
        require_one_ros(sourced)
    assert f'{tmp_path}/opt/ros' in str(error.value)
    assert sys.prefix in str(error.value)
    require_one_ros({})


@pytest.mark.parametrize('wheels', [False], indirect=True)
def test_a_sourced_installation_alone_is_fine(sourced: dict[str, str], wheels: None) -> None:
    require_one_ros(sourced)
