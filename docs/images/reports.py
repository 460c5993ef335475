# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Pictures of the report on both demos, in docs/images; Chromium takes them.

tdm demo pendulum; tdm demo robots
PYTHONPATH=. python docs/images/reports.py pendulum/bag robots/bag
"""

from __future__ import annotations

import base64
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
import time

from tdm_sim.report.page import write_report
from tdm_sim.report.reader import read_mission
from tools.browser import chromium, open_browser, open_report

IMAGES = Path(__file__).resolve().parent
SIZE = 1280, 1000  # px
PICTURES = {'report_pendulum.png': 1.08, 'report_robots.png': 15.5}  # s: instant of the motion


def main() -> None:
    """Write the pictures."""
    if chromium() is None:
        raise SystemExit('Chromium is needed: apt-get install chromium chromium-driver')
    with TemporaryDirectory() as folder, open_browser(Path(folder) / 'profile') as driver:
        for bag, (name, instant) in zip(sys.argv[1:], PICTURES.items(), strict=True):
            report = Path(folder) / f'{name}.html'
            write_report(read_mission(Path(bag)), report)
            open_report(driver, report, SIZE)
            driver.execute_script('report.clock.set(arguments[0])', instant)
            time.sleep(0.5)  # until what was set is drawn
            options = {'captureBeyondViewport': False}
            taken = driver.execute_cdp_cmd('Page.captureScreenshot', options)
            (IMAGES / name).write_bytes(base64.b64decode(taken['data']))


if __name__ == '__main__':
    main()
