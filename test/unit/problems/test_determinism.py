# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The same request and seed give the same plan to the last bit, whatever the process is like."""

from __future__ import annotations

from planned_apart import planned_apart


def test_processes_and_the_order_of_sets_change_nothing() -> None:
    assert planned_apart(PYTHONHASHSEED='0') == planned_apart(PYTHONHASHSEED='1')
