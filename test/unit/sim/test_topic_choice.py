# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import pytest
from tdm_sim.topic_choice import TopicChoice


@pytest.mark.parametrize('namespace', ['robots', '/robots', '/robots/'])
def test_a_namespace(namespace):
    choice = TopicChoice(namespace=namespace)
    assert choice.wants('/robots/plan_summary')
    assert choice.wants('/robots/robot1/odom')
    for shared in ('/clock', '/diagnostics', '/rosout', '/tf', '/tf_static'):
        assert choice.wants(shared)
    assert not choice.wants('/robots2/plan_summary')
    assert not choice.wants('/pendulum/robots/plan_summary')
    assert not choice.wants('/robots/_hidden/odom')


def test_names_and_a_namespace():
    choice = TopicChoice(frozenset({'/chosen', '/_hidden'}))
    assert choice.wants('/chosen')
    assert choice.wants('/_hidden')
    assert not choice.wants('/tf')
    both = TopicChoice(frozenset({'/chosen'}), 'robots')
    assert both.wants('/chosen')
    assert both.wants('/robots/plan_summary')
    assert not both.wants('/other')


def test_everything_but_what_is_hidden():
    for choice in (TopicChoice(), TopicChoice(namespace='/')):
        assert choice.wants('/x/y')
        assert not choice.wants('/_x/y')
        assert not choice.wants('/x/_y')
