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
import re

from launch_stand_ins import install
import pytest
from tdm_planner.cli import _parser
from tdm_sim.record_command import record_command, topics_pattern
from tdm_sim.topic_choice import TopicChoice

TOPICS = (
    *('/robots/robot1/odom', '/robots/plan_summary', '/robots2/path', '/odom', '/clock'),
    *('/diagnostics', '/tf', '/tf_static', '/rosout', '/a/robots/odom', '/diagnostics_agg'),
)


@pytest.mark.parametrize('namespace', ['robots', '/robots/', 'hall/a', ''])
def test_both_recorders_take_the_same_topics(namespace: str):
    choice = TopicChoice(namespace=f'/{namespace}')
    pattern = re.compile(topics_pattern(namespace))
    for topic in (*TOPICS, '/hall/a/odom', '/hall/abc'):
        assert bool(pattern.search(topic)) == choice.wants(topic), topic


@pytest.fixture
def ros2_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    marker = tmp_path / 'share/ament_index/resource_index/packages/ros2bag'
    marker.parent.mkdir(parents=True)
    marker.touch()
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path}')


@pytest.mark.usefixtures('ros2_bag')
def test_ros2_bag_records_where_it_is_installed():
    command = record_command('hall/a', 'my_bag')
    assert command[:3] == ['ros2', 'bag', 'record']
    assert command[3:] == ['--output', 'my_bag', '--regex', topics_pattern('hall/a')]
    assert record_command('hall/a', 'my_bag', use_sim_time=True) == [*command, '--use-sim-time']


@pytest.fixture
def tdm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the command of a workspace that colcon built; its Python need not be this one."""
    install(tmp_path, 'tdm_planner')
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path}')
    return str(tmp_path / 'lib/tdm_planner/tdm')


def test_the_installed_tdm_records_elsewhere(tdm: str):
    program, *words = record_command('hall/a', 'my_bag')
    assert program == tdm
    options = _parser().parse_args(words)
    assert (options.output, options.namespace) == (Path('my_bag'), '/hall/a')
    assert record_command('hall/a', 'my_bag', use_sim_time=True) == [program, *words]


@pytest.mark.usefixtures('tdm')
def test_recordings_are_named_after_namespace_and_time():
    for namespace, name in (('/hall/a', 'hall_a'), ('', 'tdm')):
        words = record_command(namespace)
        folder = words[words.index('--output') + 1]
        assert re.fullmatch(rf'{name}_\d{{4}}(_\d\d){{2}}-\d\d(_\d\d){{2}}', folder)
