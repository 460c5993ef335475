# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Which topics are recorded, and by which recorder."""

from __future__ import annotations

from pathlib import Path
import re

import pytest
from tdm_planner.cli import _parser
from tdm_sim.record_command import record_command, topics_pattern
from tdm_sim.topic_choice import TopicChoice

SHARED = {'/clock', '/diagnostics', '/rosout', '/tf', '/tf_static'}
OTHERS = {'/robots/robot1/odom', '/robots2/path', '/odom', '/a/robots/odom', '/diagnostics_agg',
          '/hall/a/odom', '/hall/abc'}  # fmt: skip


@pytest.mark.parametrize(
    ('namespace', 'wanted'),
    [
        *((name, {'/robots/robot1/odom'}) for name in ('robots', '/robots', '/robots/')),
        ('hall/a', {'/hall/a/odom'}),
        ('/', OTHERS),
    ],
)
def test_a_namespace_is_recorded_with_what_belongs_to_none_alike_by_both_recorders(
    namespace: str, wanted: set[str]
) -> None:
    choice, pattern = TopicChoice(namespace=namespace), re.compile(topics_pattern(namespace))
    for topic in SHARED | OTHERS:
        assert choice.wants(topic) == (topic in SHARED | wanted), topic
        assert bool(pattern.search(topic)) == choice.wants(topic), topic
    assert not choice.wants('/robots/_hidden/odom')


def test_topics_are_recorded_by_name_or_all() -> None:
    choice = TopicChoice(frozenset({'/chosen', '/_hidden'}))
    both = TopicChoice(frozenset({'/chosen'}), 'robots')
    asked = ('/chosen', '/_hidden', '/robots/path', '/tf', '/other', '/x/_y')
    for chosen, wanted in ((choice, '110000'), (both, '101100'), (TopicChoice(), '101110')):
        assert [chosen.wants(topic) for topic in asked] == [flag == '1' for flag in wanted]


def install(prefix: Path, package: str, program: str = '') -> None:
    """Have a package, and one of its programs, where ROS 2 looks for them."""
    marker = prefix / 'share/ament_index/resource_index/packages' / package
    marker.parent.mkdir(parents=True)
    marker.touch()
    if program:
        path = prefix / 'lib' / package / program
        path.parent.mkdir(parents=True)
        path.touch(0o755)


def test_ros2_bag_records_where_it_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, 'ros2bag')
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path}')
    command = record_command('hall/a', 'my_bag')
    assert command[:3] == ['ros2', 'bag', 'record']
    assert command[3:] == ['--output', 'my_bag', '--regex', topics_pattern('hall/a')]
    assert record_command('hall/a', 'my_bag', use_sim_time=True) == [*command, '--use-sim-time']


def test_the_installed_tdm_records_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a workspace that colcon built; its Python need not be this one."""
    install(tmp_path, 'tdm_planner', 'tdm')
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path}')
    program, *words = record_command('hall/a', 'my_bag')
    assert program == str(tmp_path / 'lib/tdm_planner/tdm')
    options = _parser().parse_args(words)
    assert (options.output, options.namespace) == (Path('my_bag'), '/hall/a')
    assert record_command('hall/a', 'my_bag', use_sim_time=True) == [program, *words]
    for namespace, name in (('/hall/a', 'hall_a'), ('', 'tdm')):
        words = record_command(namespace)
        folder = words[words.index('--output') + 1]
        assert re.fullmatch(rf'{name}_\d{{4}}(_\d\d){{2}}-\d\d(_\d\d){{2}}', folder)
