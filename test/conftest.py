# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures shared by all tests; those that need ROS skip where rclpy is not installed."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from ros_harness import reserved_domain, Ros, ros_environment


@pytest.fixture(scope='module')
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros]:
    """Yield a ROS domain for the test module; nodes started in it end with the module."""
    pytest.importorskip('rclpy')
    folder = tmp_path_factory.mktemp('ros')
    with reserved_domain() as domain, pytest.MonkeyPatch.context() as patch:
        environment = ros_environment(domain, folder)
        for name, value in environment.items():
            patch.setenv(name, value)
        harness = Ros(domain, folder, environment)
        try:
            yield harness
        finally:
            harness.close()
