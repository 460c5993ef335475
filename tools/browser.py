# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A headless Chromium that asks nothing of the network, for tests and pictures of pages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
from pathlib import Path
import shutil
import time
from typing import Any

FLAGS = (
    '--headless',
    '--no-sandbox',
    '--disable-dev-shm-usage',
    '--disable-quic',
    '--no-first-run',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
    '--hide-scrollbars',
)
FLAT, IN_SPACE = ('--disable-gpu',), ('--use-angle=swiftshader', '--enable-unsafe-swiftshader')
PATIENCE = 30.0  # s
MISSING = 'no headless Chromium: apt-get install chromium chromium-driver'


def chromium() -> str | None:
    """Return the path of Chromium if it and its driver are installed."""
    found = shutil.which('chromium') or shutil.which('chromium-browser')
    return found if shutil.which('chromedriver') else None


@contextmanager
def open_browser(profile: Path, in_space: bool = False) -> Iterator[Any]:
    """
    Start Chromium with the empty folder `profile`; yields selenium's driver.

    With `in_space` it draws what pages show in three dimensions, by software, and does not wait
    for pages to be loaded.
    """
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    options = Options()
    options.binary_location = chromium() or ''
    for flag in (*FLAGS, *(IN_SPACE if in_space else FLAT), f'--user-data-dir={profile}'):
        options.add_argument(flag)
    if in_space:
        options.page_load_strategy = 'none'
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which('chromedriver')))
    try:
        yield driver
    finally:
        driver.quit()


def logged(driver: Any, *levels: str) -> tuple[list[str], list[str]]:
    """Return console messages of these levels, and addresses requested, since the last call."""
    console = [e['message'] for e in driver.get_log('browser') if e['level'] in levels]
    events = [json.loads(e['message'])['message'] for e in driver.get_log('performance')]
    sent = [e for e in events if e['method'] == 'Network.requestWillBeSent']
    return console, [e['params']['request']['url'] for e in sent]


def set_window(driver: Any, size: tuple[int, int], pixels: float = 1.0) -> None:
    """Let the window have a size [px]; small ones are those of phones."""
    width, height = size
    metrics = {'width': width, 'height': height, 'deviceScaleFactor': pixels}
    driver.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', metrics | {'mobile': width < 600})


def open_report(
    driver: Any, report: Path, size: tuple[int, int], scheme: str = 'light', pixels: float = 1.0
) -> None:
    """Open a report in a window of a size [px], in the colour scheme `light` or `dark`."""
    set_window(driver, size, pixels)
    media = {'features': [{'name': 'prefers-color-scheme', 'value': scheme}]}
    driver.execute_cdp_cmd('Emulation.setEmulatedMedia', media)
    driver.get(report.resolve().as_uri())
    end = time.monotonic() + PATIENCE
    while not driver.execute_script('return document.documentElement.dataset.ready === "true"'):
        if time.monotonic() > end:
            raise TimeoutError(f'{report} was not drawn within {PATIENCE:g} s')
        time.sleep(0.05)
