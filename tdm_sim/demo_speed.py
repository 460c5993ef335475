# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
A demo faster or slower than real time: what its nodes are told so that the mission is the same.

One plant drives `/clock`, all others follow it. Solving takes real time, and so does sending a
message: where simulated time runs faster, what must cover them is longer in simulated time. The
rates are lowered so that the computer has no more to do in a second than it can.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tdm_planner.nodes.tracker import tracker_specifications
from tdm_planner.parameter_files import read_parameters
from tdm_planner.parameters import ParameterSpec, specifications
from tdm_planner.problems.request import RequestParameters
from tdm_sim.plant_model import SimulationParameters

Settings = dict[str, Any]

# Of the parameters of each node, those that cover what takes real time.
_COVER_REAL_TIME: Mapping[str, tuple[str, ...]] = {
    'planner': ('start.delay', 'start.max_age', 'replan.delay'),
    'tracker': ('state_timeout', 'replan.interval'),
    'pendulum_plant': ('command_timeout',),
    'robot_plant': ('command_timeout',),
    'plant': ('command_timeout',),
}
_DECLARED: Mapping[str, Callable[[], Mapping[str, ParameterSpec]]] = {
    'planner': lambda: specifications(RequestParameters),
    'tracker': lambda: tracker_specifications('pendulum'),
    'pendulum_plant': lambda: specifications(SimulationParameters),
    'robot_plant': lambda: specifications(SimulationParameters),
    'plant': lambda: specifications(SimulationParameters),
}


def speed_settings(
    executable: str,
    file: Path,
    speed: float,
    drives_clock: bool,
    rates: float = 1.0,
    followers: Sequence[str] = ('joint_command',),
    namespace: str | None = None,
) -> Settings:
    """
    Return what a node is told beside the parameter file, for a demo `speed` times real time.

    `rates` is how many times more often than at real time the nodes may be called in a second;
    `followers` are the topics whose publishers the clock waits for. Of the parameter file those
    sections count that are for the node in `namespace`; None: in any.
    """
    if speed == 1.0:
        return {}
    declared = _DECLARED[executable]()
    given = read_parameters(file, node=executable, namespace=namespace, required=False)
    settings: Settings = {'use_sim_time': not drives_clock}
    if drives_clock:
        settings |= {'publish_clock': True, 'real_time_factor': speed}
        settings['clock_followers'] = list(followers)
    for name in _COVER_REAL_TIME[executable]:
        spec = declared[name]
        value = float(given.get(name, spec.default)) * max(speed, 1.0)
        settings[name] = min(value, spec.range.upper)
    if 'rate' in declared:
        rate = float(given.get('rate', declared['rate'].default))
        settings['rate'] = rate * min(rates / speed, 1.0)
    return settings
