# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""What ``tdm report`` does: read a recording or a plan, write the page, show it if asked to."""

from __future__ import annotations

from pathlib import Path

from tdm_planner.plan_files import check_path
from tdm_sim.progress import Progress
from tdm_sim.report.page import write_report
from tdm_sim.report.reader import read_mission

ENDINGS = ('.html', '.htm')


def make_report(
    source: Path, output: Path, progress: Progress, namespace: str | None = None
) -> None:
    """Write the report on a recording or a plan file.

    `namespace` chooses among several planners in one recording.

    Raises
    ------
    TdmError
        If the source cannot be read or the report not be written.
    """
    check_path(output, ENDINGS)
    progress.phase(f'reading {source}')
    mission = read_mission(source, namespace)
    progress.phase(f'writing {output}')
    write_report(mission, output)
