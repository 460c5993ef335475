# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Stand-ins for the few classes of `launch` and `launch_ros` that the launch files use.

There are no wheels of `launch`; test/nightly/test_real_launch.py uses the real one where it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
import runpy
import sys
from types import ModuleType
from typing import Any

import pytest
from ros_harness import MODULES, SOURCE


@dataclass
class LaunchContext:
    launch_configurations: Mapping[str, str]
    is_shutdown: bool = False


@dataclass(frozen=True)
class LaunchConfiguration:
    name: str

    def perform(self, context: LaunchContext) -> str:
        return context.launch_configurations[self.name]


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: str
    description: str
    choices: list[str] | None = None


@dataclass
class OpaqueFunction:
    function: Any


@dataclass
class Node:
    package: str
    executable: str
    output: str
    namespace: Any = ''
    parameters: list[Any] = field(default_factory=list)
    arguments: list[str] = field(default_factory=list)
    ros_arguments: list[Any] = field(default_factory=list)
    on_exit: Any = None
    respawn: bool = False
    respawn_delay: float = 0.0
    respawn_max_retries: int = -1


@dataclass
class ExecuteProcess:
    cmd: list[str]
    name: str
    output: str
    on_exit: Any


@dataclass
class ParameterValue:
    value: str
    value_type: type


@dataclass
class LaunchDescription:
    entities: list[Any] = field(default_factory=list)

    def arguments(self) -> list[DeclareLaunchArgument]:
        return [item for item in self.entities if isinstance(item, DeclareLaunchArgument)]

    def started(self, pushed: str | None = None, **arguments: str) -> list[Any]:
        """Return what starts for the given arguments, within a PushROSNamespace."""
        declared = {item.name: item for item in self.arguments()}
        assert set(arguments) <= set(declared)
        context = {name: item.default_value for name, item in declared.items()} | arguments
        for name, item in declared.items():
            assert item.choices is None or context[name] in item.choices
        if pushed is not None:
            context['ros_namespace'] = pushed
        (function,) = (e.function for e in self.entities if isinstance(e, OpaqueFunction))
        return list(function(LaunchContext(context)))


OURS: dict[str, tuple[type, ...]] = {
    'launch': (LaunchDescription, LaunchContext),
    'launch.actions': (DeclareLaunchArgument, ExecuteProcess, OpaqueFunction),
    'launch.launch_context': (LaunchContext,),
    'launch.substitutions': (LaunchConfiguration,),
    'launch_ros': (),
    'launch_ros.actions': (Node,),
    'launch_ros.parameter_descriptions': (ParameterValue,),
}
EXECUTABLES = {
    'tdm_planner': [*MODULES, 'tdm'],
    'robot_state_publisher': ['robot_state_publisher'],
    'rviz2': ['rviz2'],
}


def install(prefix: Path, package: str) -> None:
    """Install a package's programs, which do nothing, where ROS 2 looks for them."""
    index = prefix / 'share/ament_index/resource_index/packages'
    index.mkdir(parents=True, exist_ok=True)
    (index / package).touch()
    for name in EXECUTABLES[package]:
        program = prefix / 'lib' / package / name
        program.parent.mkdir(parents=True, exist_ok=True)
        program.touch(0o755)


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Put the stand-ins in place, and all programs."""
    prefix = tmp_path / 'ros'
    for package in EXECUTABLES:
        install(prefix, package)
    (prefix / 'share/tdm_planner').symlink_to(SOURCE)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(prefix))
    for name, classes in OURS.items():
        module = ModuleType(name)
        vars(module).update({made.__name__: made for made in classes})
        monkeypatch.setitem(sys.modules, name, module)
    # Which of them it was imported with must not outlive the test.
    monkeypatch.delitem(sys.modules, 'tdm_planner.launching', raising=False)


def described(name: str) -> LaunchDescription:
    """Return what a launch file describes."""
    file = SOURCE / 'launch' / f'{name}.launch.py'
    made = runpy.run_path(str(file))['generate_launch_description']()
    assert isinstance(made, LaunchDescription)
    return made
