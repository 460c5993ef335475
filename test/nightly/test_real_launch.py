# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The launch files under the real ``ros2 launch``, where it is installed: nothing is left."""

from collections.abc import Callable
import os
from pathlib import Path
import re
import shutil
import signal
import sys

from launch_stand_ins import installed
import pytest
from ros_harness import MODULES, Ros, SOURCE
from signal_scenes import survivors

pytest.importorskip('launch_ros')
pytest.importorskip('ros2launch')


class Launched:
    """A ``ros2 launch`` in the domain, which all that it starts are in as well."""

    def __init__(self, ros: Ros, words: list[str], environment: dict[str, str]) -> None:
        self.ros = ros
        self.launch = ros.run(str(shutil.which('ros2')), ['launch', *words], environment)

    def running(self, name: str = '') -> list[int]:
        """Return the processes of the domain, or those of an executable of ours."""
        return survivors(f'ROS_DOMAIN_ID={self.ros.domain}', name and f'/{name}\0')

    def wait_for(self, condition: Callable[[], bool]) -> None:
        assert self.ros.spin_until(condition, 120.0), self.launch.output

    def ended(self) -> int:
        """Wait until launch ends; nothing of it may be left."""
        code = self.launch.process.wait(120.0)
        assert not self.running(), self.launch.output
        assert 'Traceback' not in self.launch.output, self.launch.output
        return code


@pytest.fixture
def launch(ros: Ros, tmp_path: Path) -> Callable[..., Launched]:
    """Launch from where this source tree is installed as by colcon, and nothing else is."""
    text = f'#!{sys.executable}\nimport sys\nfrom {{}} import main\nsys.exit(main())\n'
    modules = {**MODULES, 'tdm': 'tdm_planner.cli'}
    programs = {name: text.format(module) for name, module in modules.items()}
    prefix = installed(tmp_path / 'install', {'tdm_planner': programs})

    def start(name: str, *arguments: str) -> Launched:
        file = str(SOURCE / 'launch' / f'{name}.launch.py')
        return Launched(ros, [file, *arguments], {'AMENT_PREFIX_PATH': str(prefix)})

    return start


def test_all_of_it_is_recorded_and_ended_by_one_interrupt(launch, tmp_path):
    words = ('number_of_robots:=2', 'record:=True', f'bag:={tmp_path / "bag"}')
    launched = launch('robots', *words)
    launched.wait_for(lambda: 'planner]: active' in launched.launch.output)
    launched.wait_for(lambda: any((tmp_path / 'bag').glob('*.mcap')))
    assert len(launched.running()) == 1 + 1 + 4 + 1
    os.killpg(launched.launch.process.pid, signal.SIGINT)
    assert launched.ended() == 0
    assert (tmp_path / 'bag/metadata.yaml').is_file()


def test_what_cannot_be_started_ends_the_launch(launch):
    """robot_state_publisher is not installed where this looks for packages."""
    launched = launch('pendulum')
    assert launched.ended() == 1
    assert 'robot_state_publisher' in launched.launch.output


def test_a_launch_ends_with_its_plant(launch):
    launched = launch('pendulum', 'description:=false')
    launched.wait_for(lambda: 'planner]: active' in launched.launch.output)
    launched.wait_for(lambda: bool(launched.running('pendulum_plant')))
    os.kill(launched.running('pendulum_plant')[0], signal.SIGKILL)
    assert launched.ended() == 1
    assert 'pendulum_plant ended with code -9: the launch ends' in launched.launch.output


def test_the_tracker_of_a_real_plant_goes_on_without_planner(launch):
    launched = launch('pendulum', 'description:=false', 'plant:=false')
    launched.wait_for(lambda: 'planner]: active' in launched.launch.output)
    (tracker,) = launched.running('tracker')
    os.kill(launched.running('planner')[0], signal.SIGKILL)
    launched.wait_for(lambda: 'process has died' in launched.launch.output)
    # launch has handled the end before it starts a tracker that has died anew
    os.kill(tracker, signal.SIGKILL)
    launched.wait_for(lambda: len(re.findall(r'tracker\]: active', launched.launch.output)) == 2)
    assert not launched.running('planner')
    os.killpg(launched.launch.process.pid, signal.SIGINT)
    assert launched.ended() == 0
