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

"""What ``tdm report`` does: read a recording or a plan, write the page, show it if asked to."""

from __future__ import annotations

from pathlib import Path

from tdm_planner.plan_files import check_path
from tdm_planner.problems.registry import load_problem
from tdm_sim.progress import Progress
from tdm_sim.report.page import write_report
from tdm_sim.report.reader import read_mission

ENDINGS = ('.html', '.htm')


def make_report(
    source: Path,
    output: Path,
    progress: Progress,
    namespace: str | None = None,
    problem: str | None = None,
) -> None:
    """
    Write the report on a recording or a plan file.

    `namespace` chooses among several planners in one recording; `problem` names one that is not
    installed, ``module:Class``.

    Raises
    ------
    TdmError
        If the source cannot be read or the report not be written.

    """
    check_path(output, ENDINGS)
    progress.phase(f'reading {source}')
    given = None if problem is None else load_problem(problem)
    mission = read_mission(source, namespace, given)
    progress.phase(f'writing {output}')
    write_report(mission, output)
