# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Pictures of the report on both demos, for the README: ``python -m tools.screenshots``.

Runs the demos, or takes recordings of them: ``--pendulum BAG --robots BAG``.
"""

from __future__ import annotations

import argparse
import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

from tdm_sim.report.page import write_report
from tdm_sim.report.reader import read_mission
from tools.browser import chromium, open_browser, open_report

IMAGES = Path(__file__).resolve().parents[1] / 'docs' / 'images'


@dataclass(frozen=True)
class Picture:
    """A report in a window of `size` [px], at an instant of the motion [s]."""

    name: str
    plant: str
    size: tuple[int, int]
    instant: float


PICTURES = (
    Picture('report_pendulum.png', 'pendulum', (1280, 1000), 1.08),
    Picture('report_robots.png', 'robots', (1280, 1000), 15.5),
    Picture('report_phone.png', 'robots', (390, 844), 10.0),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the pictures; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n')[0])
    for plant in ('pendulum', 'robots'):
        parser.add_argument(f'--{plant}', type=Path, metavar='BAG', help='default: run the demo')
    parser.add_argument('-o', '--output', type=Path, default=IMAGES, metavar='DIR')
    options = parser.parse_args(arguments)
    if chromium() is None:
        print('Chromium is needed: apt-get install chromium chromium-driver', file=sys.stderr)
        return 2
    options.output.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as folder:
        scratch = Path(folder)
        reports = {
            plant: _report(plant, getattr(options, plant), scratch)
            for plant in ('pendulum', 'robots')
        }
        with open_browser(scratch / 'profile') as driver:
            for picture in PICTURES:
                path = options.output / picture.name
                path.write_bytes(_taken(driver, picture, reports[picture.plant]))
                print(f'{path} ({path.stat().st_size / 1e3:.0f} kB)')
    return 0


def _report(plant: str, bag: Path | None, scratch: Path) -> Path:
    if bag is None:
        bag = scratch / plant / 'bag'
        command = [sys.executable, '-m', 'tdm_planner.cli', 'demo', plant, '-o', str(bag.parent)]
        subprocess.run(command, check=True)
    path = scratch / f'{plant}.html'
    write_report(read_mission(bag), path)
    return path


def _taken(driver: Any, picture: Picture, report: Path) -> bytes:
    open_report(driver, report, picture.size)
    driver.execute_script('report.clock.set(arguments[0])', picture.instant)
    time.sleep(0.5)  # until what was set is drawn
    data = driver.execute_cdp_cmd('Page.captureScreenshot', {'captureBeyondViewport': False})
    return base64.b64decode(data['data'])


if __name__ == '__main__':
    sys.exit(main())
