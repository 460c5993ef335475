# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parameters that every tracker has."""

from __future__ import annotations

from dataclasses import dataclass

from tdm_planner.parameters import group, parameter, POSITIVE, Range, Validated

NOISE = Range(1e-9, 1e6)  # of standard deviations; their squares are computed with


@dataclass(frozen=True)
class Tolerances(Validated):
    """How far the state may be from the trajectory: an angle, unless a plant says otherwise."""

    start: float = parameter(
        0.3,
        'largest deviation at the start for a trajectory to be accepted',
        unit='rad',
        allowed=POSITIVE,
    )
    path: float = parameter(
        1.0, 'deviation from the plan at which the motion is aborted', unit='rad', allowed=POSITIVE
    )


@dataclass(frozen=True)
class ReplanOnDeviation(Validated):
    """What happens when the motion is aborted."""

    on_deviation: bool = parameter(
        False,
        'when the motion is aborted, bring the plant to rest and ask for a new plan',
    )
    interval: float = parameter(
        1.0, 'least time between two such requests', unit='s', allowed=POSITIVE
    )


@dataclass(frozen=True)
class TrackerParameters(Validated):
    """Parameters of every tracker; subclasses add the plant's own."""

    rate: float = parameter(
        200.0,
        'rate of the commands',
        unit='Hz',
        allowed=Range(1.0, 1000.0),
        read_only=True,
    )
    state_timeout: float = parameter(
        0.1,
        'age of the newest state beyond which nothing is commanded',
        unit='s',
        allowed=Range(0.0, 10.0, lower_open=True),
    )
    command_delay: float = parameter(
        0.0, 'time from sending a command to its effect', unit='s', allowed=Range(0.0, 1.0)
    )
    planner_service: str = parameter('plan', "name of the planner's service", read_only=True)
    tolerance: Tolerances = group(Tolerances)
    replan: ReplanOnDeviation = group(ReplanOnDeviation)

    @property
    def interval(self) -> float:
        """Time for which a command acts [s]."""
        return 1.0 / self.rate
