# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Six nodes under a rain of messages, parameters and requests: they go on serving."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fuzzing import profile
from hypothesis import given
from hypothesis import strategies as st
from node_fuzzing import SixNodes
from ros_harness import Ros


def test_nodes_survive_whatever_comes_and_serve_as_before(ros: Ros, tmp_path: Path) -> None:
    nodes = SixNodes(ros, tmp_path / 'home')
    for _ in range(5):
        nodes.meet()

        @profile(400, new=True)
        @given(st.data())
        def survive(data: Any) -> None:
            nodes.suffer(data.draw)

        survive()
        nodes.recover()
    assert not nodes.written()
