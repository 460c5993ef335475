# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Whether a new plan supersedes the active one: if that fails or is worse by a margin."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Final

from tdm_planner.problems.solution import Solution

LEAST_LEFT: Final = 0.25  # of the whole cost; with less to come a plan is kept if it will do


@dataclass(frozen=True)
class Outlook:
    """
    Predicted outcome of the active plan if its execution continues.

    `cost` is the performance index J still to come; `failure` a sentence where the feedback will
    not keep the plant on it, or a limit is endangered, else empty; `settled` says that the
    feedback about the goal has the plant: there is nothing left to plan.
    """

    cost: float = math.inf
    failure: str = ''
    settled: bool = False


@dataclass(frozen=True)
class Decision:
    """Whether the new plan supersedes the active one, and why, or why not."""

    take_over: bool
    reason: str


def worth_improving(outlook: Outlook, whole: float, improvement: float) -> bool:
    """
    Whether a plan that would do has so much cost still to come that a better one may matter.

    `whole` is the cost of the whole way. Near the goal the little that is left is no reason for a
    plan: noise makes it more or less.
    """
    return not outlook.settled and improvement < 1.0 and outlook.cost > LEAST_LEFT * whole


def decide(outlook: Outlook, changed: bool, new: Solution | None, improvement: float) -> Decision:
    """
    Keep the active plan unless a verified one is necessary, or cheaper by a margin.

    `changed` says that another goal or other limits are asked for than those of the active plan;
    `new` is the verified plan found, if any; `improvement` the share of the cost still to come
    that it must save where the old plan would do.
    """
    if new is None:
        return Decision(False, outlook.failure or 'no better plan was found')
    if not new.verification.ok:
        return Decision(False, 'the new plan did not pass its check')
    if changed:
        return Decision(True, 'the problem has changed')
    if outlook.failure:
        return Decision(True, outlook.failure)
    saved = 1.0 - new.cost / outlook.cost if outlook.cost > 0.0 else 0.0
    if saved > improvement:
        return Decision(True, f'it saves {saved:.0%} of the cost still to come')
    return Decision(False, 'the active plan does')
