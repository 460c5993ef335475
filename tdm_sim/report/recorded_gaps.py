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

"""What a recording does not hold, and what follows from it, in sentences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from tdm_sim.report import untrusted
from tdm_sim.report.mission import PlanFigures, Vehicle
from tdm_sim.report.plan_documents import PlanSummary
from tdm_sim.report.recorded_topics import RecordedTopics
from tdm_sim.report.recorded_vehicles import Site

_Topic = tuple[str, Callable[[Vehicle], object], str]

_PENDULUM_TOPICS: tuple[_Topic, ...] = (
    ('joint_states', lambda v: v.states, 'what the plant did is not known'),
    ('joint_command', lambda v: v.commands, 'what the tracker asked for is not known'),
    ('tracking_error', lambda v: v.tracking_error, 'errors are computed from states and plans'),
)
_ROBOT_TOPICS: tuple[_Topic, ...] = (
    ('odom', lambda v: v.states, 'how the robot moved is not known'),
    ('joint_states', lambda v: v.applied, 'what the actuators did is not known'),
    *_PENDULUM_TOPICS[1:],
)


def gaps(
    topics: RecordedTopics,
    sites: Sequence[Site],
    vehicles: Sequence[Vehicle],
    summaries: Mapping[int, PlanSummary],
    figures: Sequence[PlanFigures],
    names: Mapping[Site, str],
) -> list[str]:
    """Say what is not in the recording, and what follows."""
    found = []
    for site, vehicle in zip(sites, vehicles, strict=True):
        where = untrusted.text(site.namespace, 100)
        expected = {'pendulum': _PENDULUM_TOPICS, 'robot': _ROBOT_TOPICS}.get(site.plant, ())
        found += [
            f'{where}/{name} is not in the recording, or empty: {consequence}.'
            for name, of, consequence in expected
            if of(vehicle) is None
        ]
        if not vehicle.plans:
            found.append(f'There is no plan of {vehicle.name} in the recording.')
    planner = untrusted.text(sites[0].planner, 100)
    if not summaries:
        known = (
            'only what the diagnostics tell of the plans is known'
            if figures
            else ('neither cost nor margins of the plans are known')
        )
        found.append(
            f'{planner}/plan_summary is not in the recording: {known}, and limits and dimensions '
            'cannot be drawn.'
        )
    told = next(iter(summaries.values())).vehicles if summaries else {}
    found += [
        f'Nothing of {name}, which the plan names, is in the recording.'
        for name in told
        if name not in names.values()
    ]
    for counts, fault in (
        (topics.malformed, 'are not what their type says and were left out'),
        (topics.not_finite, 'hold values that are not finite, which were left out'),
    ):
        found += [f'{untrusted.text(t)}: {n} message(s) {fault}.' for t, n in counts.items()]
    return found
