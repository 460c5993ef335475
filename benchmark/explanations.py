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

"""Why the largest costs of a plan remain: what the profile finds, with its reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

COUNT = 3
LARGE = 0.1  # share below which a cost needs no explanation

# By function; none of them calls another, so that their shares can be compared.
EXPLANATIONS: Mapping[str, str] = MappingProxyType(
    {
        'switching_search.polish': (
            'minimising the duration of up to ten arrivals, each in some ten steps on four to '
            'eight variables. All of it is compiled, the motions with their derivatives as well '
            'as the quadratic programs of the steps; what is left is the integration of the '
            'motions.'
        ),
        'pendulum_steering.steer': (
            '300 random starts, compiled, sixteen motions side by side. It leaves one core to the '
            'control loop and uses two others where there are as many: then it takes half as long '
            'by the clock as it counts here. With an earlier plan to start from there is little '
            'of it: that plan is polished and checked first.'
        ),
        'swing_up_task.plan': (
            'the check: every plan is flown by the plant before it leaves the planner, by an '
            'integration of its own. It is never left out.'
        ),
        'formation_search.minima': (
            'minimising J from four first guesses, with an earlier plan from that one. A third '
            "of it is the robots' rows and their derivatives (`formation_program.linearise`), one "
            'compiled pass over precomputed bases for all robots, nodes and pairs; the rest the '
            'steps of the trust region on some thirty variables, whose quadratic programs daqp '
            'solves.'
        ),
        'formation_plan.trajectory': (
            'the motion as it is published, with the directions the thrusters can really take: '
            'a recursion over the instants, for every robot.'
        ),
        'formation_verification.verify_formation': (
            'the check: every motion is flown by its robot before it leaves the planner, and the '
            'distances are looked at between the samples. It is never left out.'
        ),
    }
)


@dataclass(frozen=True)
class Cost:
    """A function's share of the time of a kind of plan, and why it remains ('': not said)."""

    kind: str
    label: str
    share: float
    text: str


def largest(figures: Mapping[str, Any]) -> list[Cost]:
    """Return the largest of the costs that are told apart, of every kind of plan, by share."""
    found = []
    for kind, profile in figures.items():
        shares = {label: share for label, share in profile['costs'] if label in EXPLANATIONS}
        names = sorted(shares, key=lambda name: -shares[name])[:COUNT]
        found += [Cost(kind, name, shares[name], EXPLANATIONS[name]) for name in names]
    return found


def text(figures: Mapping[str, Any]) -> str:
    """Return the largest costs of every kind of plan, each explained where it is named first."""
    lines, said = [], set()
    for kind, profile in figures.items():
        lines.append(f'- **{kind}**, {profile["ms"]:.1f} ms:')
        for cost in largest({kind: profile}):
            reason = 'see above.' if cost.label in said else cost.text
            said.add(cost.label)
            lines.append(f'  - `{cost.label}`, {cost.share:.0%}: {reason}')
    return '\n'.join(lines)
