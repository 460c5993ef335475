# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.
"""Twenty clients at once for a minute: each call is answered, and nothing grows."""

from __future__ import annotations

from pathlib import Path

from ros_harness import Ros
from tools.soak import soak

GROWTH = 5.0  # MB in half a minute, while the planner answers thousands of requests


def test_every_call_of_many_clients_is_answered(ros: Ros, tmp_path: Path) -> None:
    found = soak(60.0, 20, tmp_path)
    assert '' not in found['answers'], 'a call had no answer'
    assert 'INTERNAL' not in found['answers']
    assert found['answers']['PLAN'] > 0
    assert found['answers']['BUSY'] > 0
    for name, (half_way, last) in found['memory [MB]'].items():
        assert last - half_way < GROWTH, name
