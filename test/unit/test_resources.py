# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Where shared files are found, wherever the package is installed."""

from pathlib import Path
import sys

import pytest
from ros_harness import SOURCE
from tdm_planner import resources


def make_share(prefix: Path, indexed: bool) -> Path:
    share = prefix / 'share' / 'tdm_planner'
    (share / 'config').mkdir(parents=True)
    (share / 'config' / 'mine.yaml').write_text('')
    if indexed:
        index = prefix / 'share/ament_index/resource_index/packages'
        index.mkdir(parents=True)
        (index / 'tdm_planner').write_text('')
    return share


@pytest.fixture(autouse=True)
def no_installation(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'python'))


def test_source_tree_is_the_last_resort():
    assert resources.share_directory() == SOURCE
    assert resources.config_file('pendulum.yaml') == SOURCE / 'config' / 'pendulum.yaml'


def test_a_sourced_workspace_comes_before_the_python_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    share = make_share(tmp_path / 'python', indexed=False)
    assert resources.share_directory() == share
    not_indexed, workspace = tmp_path / 'other', tmp_path / 'workspace'
    make_share(not_indexed, indexed=False)
    share = make_share(workspace, indexed=True)
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{not_indexed}:{workspace}')
    assert resources.share_directory() == share


def test_unknown_parameter_file_lists_those_there_are(tmp_path: Path):
    make_share(tmp_path / 'python', indexed=False)
    with pytest.raises(FileNotFoundError, match=r"'pendulum.yaml'.*there is: mine\.yaml"):
        resources.config_file('pendulum.yaml')


def test_missing_installation_names_the_places(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(resources, '__file__', str(tmp_path / 'site-packages/a/b.py'))
    with pytest.raises(FileNotFoundError, match=r'looked in .*python/share/tdm_planner'):
        resources.share_directory()
