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

"""A mission from a path: a recording or a plan file."""

from __future__ import annotations

from pathlib import Path

from tdm_sim.report.bag_files import UnreadableRecording
from tdm_sim.report.bag_reader import read_bag
from tdm_sim.report.mission import Mission
from tdm_sim.report.plan_reader import read_plan


def read_mission(path: Path | str, namespace: str | None = None) -> Mission:
    """
    Read a rosbag2 folder, a single .mcap or .db3 file, or a plan file (.json).

    A rosbag2 may be given by its metadata.yaml too. `namespace` chooses among several planners in
    one recording.

    Raises
    ------
    TdmError
        In one sentence, if nothing can be made of it.

    """
    path = Path(path)
    if path.name == 'metadata.yaml' and path.is_file():
        path = path.parent
    if path.suffix.lower() != '.json':
        return read_bag(path, namespace)
    if namespace is not None:
        raise UnreadableRecording(f"'{path}' is a plan, which has no namespaces to choose from")
    return read_plan(path)
