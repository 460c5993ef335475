# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The fixture `ros` of this folder: nodes in the test's process, under a clock that it steps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from ros_harness import reserved_domain, ros_environment


@pytest.fixture(scope='module')
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Yield a ROS domain for the test module, with a time of its own."""
    pytest.importorskip('rclpy')
    from stepped_ros import Stepped

    folder = tmp_path_factory.mktemp('ros')
    with reserved_domain() as domain, pytest.MonkeyPatch.context() as patch:
        environment = ros_environment(domain, folder)
        for name, value in environment.items():
            patch.setenv(name, value)
        harness = Stepped(domain, folder, environment)
        try:
            yield harness
        finally:
            harness.close()
