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

"""What the figures of the summary mean: the criterion behind each of them, in words."""

from __future__ import annotations

from collections.abc import Mapping

from tdm_sim.report.entries import Kind
from tdm_sim.report.mission import Mission
from tdm_sim.verdict import HOLD_TIME, LONGEST_CATCH, UPRIGHT_TOLERANCE
from tdm_sim.verdict_formation import LONGEST_SETTLING, POSITION_TOLERANCE, YAW_TOLERANCE

_WITHIN = {
    'pendulum': f'theta stays within {UPRIGHT_TOLERANCE:g} rad of upright',
    'robot': f'a robot stays within {1e3 * POSITION_TOLERANCE:g} mm and {YAW_TOLERANCE:g} rad of '
    'its place',
}
_LATEST = {'pendulum': LONGEST_CATCH, 'robot': LONGEST_SETTLING}


def criteria(mission: Mission) -> Mapping[Kind, str]:
    """Return what the figures of a kind mean; empty where nothing was measured."""
    if not mission.was_carried_out:
        return {}
    found: dict[Kind, str] = {
        'landing': 'State at the planned end less the goal; planned: of the replayed plan.',
        'planner': 'Requests count from the first plan on, errors from the start of its motion '
        'on; what came before stands under Events only.',
    }
    within = _WITHIN.get(mission.vehicles[0].plant)
    if within is not None:
        found['duration'] = (
            f'At the goal: from when on {within}, planned and measured alike. A plan ends at '
            'rest, which is later.'
        )
        found['cost'] = (
            'Achieved: all terms of the measured motion until the planned end or, where the goal '
            'is reached later, until then.'
        )
    return found


def verdict_criterion(mission: Mission) -> str:
    """Return what it takes for the goal to count as reached and held; '' if it is not known."""
    plant = mission.vehicles[0].plant if mission.vehicles else 'other'
    within = _WITHIN.get(plant)
    if within is None:
        return ''
    kept = 'limits of torque and disk' if plant == 'pendulum' else 'distances'
    return (
        f'At the latest {_LATEST[plant]:g} s after the planned end {within}, for at least '
        f'{HOLD_TIME:g} s; {kept} kept.'
    )
