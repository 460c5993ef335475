# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
One demo mission with the plants here and planner and trackers on another host.

    python -m tools.mission_apart SCENE FOLDER [--control COMMAND] [-p NAME:=VALUE]...

COMMAND, put before a command, runs it on the other host. Everything is judged from what the plants
publish. FOLDER gets mission.json: the verdict, and what became of the streams of messages.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
import os
from pathlib import Path
import shlex
import signal
import sys
from typing import Any

import numpy as np
from tdm_planner.exceptions import TdmError
from tdm_planner.parameter_files import read_parameters
from tdm_planner.resources import config_file
from tdm_sim.demo import SCENES
from tdm_sim.demo_pendulum import PendulumScene
from tdm_sim.demo_scene import Scene
from tdm_sim.processes import NodeProcesses
from tools.missions import MissionControl, MissionFailed, Outcome
from tools.priority import make_real_time
from tools.streams import compare, Stream
import yaml

SETTLING = 3.0  # s; states flow for a while before the plan is asked for
_PLANNING = 'planner'
_OF_PLANNER = ('solver.', 'start.', 'torque_reserve:')


def carry_out(
    name: str, folder: Path, control: Sequence[str], settings: Sequence[str], real_time: int
) -> dict[str, Any]:
    """
    Carry one mission out and return what is to be told of it.

    Raises
    ------
    ProcessFailed, MissionFailed
        If a node ended or did not come up.

    """
    values = {n: yaml.safe_load(v) for n, _, v in (s.partition(':=') for s in settings)}
    file = config_file(f'{name}.yaml').resolve()
    scene = SCENES[name](_known({**read_parameters(file)}, values), file)
    topics = _topics(scene)
    with NodeProcesses(folder / 'log') as processes:
        for side, within in (('plants', ()), ('control', control)):
            processes.start(
                f'probe_{side}',
                'tools.stream_probe',
                [str(folder / f'{side}.npz'), *(f'{t}={k}' for t, k in topics.items())],
                within,
            )
        for node, module, arguments in scene.nodes():
            here = module.startswith('tdm_sim.')
            set_here = [word for s in _settings_for(module, settings) for word in ('-p', s)]
            processes.start(node, module, [*arguments, *set_here], () if here else control)
        make_real_time(processes.identifiers, real_time)
        with MissionControl({name: scene}, processes) as mission_control:
            mission_control.wait_for_nodes()
            mission_control.wait(lambda: False, SETTLING)
            outcome = mission_control.fly(name)
        codes = processes.end()
    unclean = [f'{node} ended with exit code {code}' for node, code in codes.items() if code]
    return {
        **outcome.to_dict(),
        'unclean': unclean,
        'streams': {t: s.to_dict() for t, s in _streams(folder, scene, outcome).items()},
        'tracking': _tracking(folder, scene, outcome),
    }


def _settings_for(module: str, settings: Sequence[str]) -> list[str]:
    """Return those settings that a node has: most are the trackers' alone."""
    kind = module.rsplit('.', 1)[-1]
    if kind == 'tracker':
        return [s for s in settings if not s.startswith(_OF_PLANNER)]
    own = ('limits.', 'rate:') if kind != _PLANNING else ('limits.', *_OF_PLANNER)
    return [s for s in settings if s.startswith(own)]


def _known(parameters: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    return {**parameters, **{n: v for n, v in values.items() if n in parameters}}


def _topics(scene: Scene) -> dict[str, str]:
    found = {}
    for plant in scene.plants:
        found[f'{plant}/joint_states'] = 'JointState'
        if not isinstance(scene, PendulumScene):
            found[f'{plant}/odom'] = 'Odometry'
        found[f'{plant}/joint_command'] = 'JointState'
        found[f'{plant}/tracking_error'] = 'JointState'
    return found


def _streams(folder: Path, scene: Scene, outcome: Outcome) -> dict[str, Stream]:
    """States on their way to the trackers, commands on their way to the plants."""
    with np.load(folder / 'plants.npz') as here, np.load(folder / 'control.npz') as there:
        window = outcome.began, outcome.ended - 0.5
        found = {}
        for topic in _topics(scene):
            if topic.endswith('tracking_error'):
                continue
            to_plants = topic.endswith('joint_command')
            sent, arrived = (there, here) if to_plants else (here, there)
            period = float(np.median(np.diff(sent[topic][:, 0])))
            found[topic] = compare(sent[topic], arrived[topic], round(period, 3), window)
        return found


def _tracking(folder: Path, scene: Scene, outcome: Outcome) -> dict[str, list[float]]:
    """Return the largest tracking errors of the first three positions, by plant."""
    found = {}
    with np.load(folder / 'control.npz') as there:
        for plant in scene.plants:
            rows = there.get(f'{plant}/tracking_error positions')
            if rows is not None:
                found[plant] = np.abs(rows[:, :3]).max(axis=0).tolist()
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Carry it out; returns the exit code: 0 whether the goal was reached or not."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    parser.add_argument('scene', choices=SCENES)
    parser.add_argument('folder', type=Path)
    parser.add_argument('--control', type=shlex.split, default=[], metavar='COMMAND')
    parser.add_argument('-p', dest='settings', action='append', default=[], metavar='NAME:=VALUE')
    parser.add_argument('--real-time', type=int, default=0)
    given = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the nodes are ended as well
    given.folder.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault('ROS_LOG_DIR', str(given.folder / 'log' / 'ros'))
    try:
        found = carry_out(
            given.scene, given.folder, given.control, given.settings, given.real_time
        )
    except (MissionFailed, TdmError, ValueError) as error:
        print(f'mission: {error}', file=sys.stderr)
        return 1
    (given.folder / 'mission.json').write_text(json.dumps(found, indent=1) + '\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
