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

"""Priority of measured processes on a machine that does other things besides."""

from __future__ import annotations

from collections.abc import Mapping
import os

_FURTHER = 10  # levels of SCHED_RR between what takes long and what must be quick


def make_real_time(identifiers: Mapping[str, int], level: int, and_this: bool = True) -> None:
    """
    Give processes just started, by name, `and_this` one, real-time priority; needs root.

    `level` is that of planners and the like, in 1..89; plants and trackers go before them, as on
    a robot's computer. 0 leaves everything as it is.
    """
    if not level:
        return
    this = {'this': os.getpid()} if and_this else {}
    for name, identifier in {**identifiers, **this}.items():
        quick = 'plant' in name or 'tracker' in name
        priority = os.sched_param(level + _FURTHER * quick)
        os.sched_setscheduler(identifier, os.SCHED_RR, priority)
