# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""SIGINT, SIGTERM and a double Ctrl-C in every phase, and 40 instants of the start."""

from __future__ import annotations

from pathlib import Path
import time

import pytest
from ros_harness import Ros
from signal_scenes import demo, PHASES, SCENES, starting, WAYS

in_every_way = pytest.mark.parametrize('way', WAYS)


@in_every_way
@pytest.mark.parametrize('name', ['planner', 'tracker', 'pendulum_plant', 'robot_plant', 'tdm'])
def test_while_it_starts(ros: Ros, name: str, way: str) -> None:
    for k in range(40):
        subject = starting(ros, name)
        time.sleep(0.05 * k)
        subject.end(way)


@in_every_way
@pytest.mark.parametrize('scene', SCENES)
def test_while_it_runs(ros: Ros, scene: str, way: str) -> None:
    subject = SCENES[scene](ros)
    subject.end(way)
    if scene == 'busy_recorder':  # what it has recorded can be read
        highlevel = pytest.importorskip('rosbags.highlevel')
        with highlevel.AnyReader([Path(str(subject.arguments[-1]))]) as reader:
            assert reader.message_count > 10


@in_every_way
@pytest.mark.parametrize('phase', PHASES)
def test_the_demo(ros: Ros, phase: str, way: str) -> None:
    demo(ros, phase).end(way, code=128 + WAYS[way][0][0])
