# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Stand-ins for what launch files use of `launch`, which test/nightly/test_real_launch.py uses."""

from collections.abc import Mapping
from dataclasses import dataclass, make_dataclass
from pathlib import Path
import runpy
import sys
from types import ModuleType
from typing import Any

import pytest
from ros_harness import MODULES, SOURCE


@dataclass(frozen=True)
class LaunchConfiguration:
    name: str

    def perform(self, context: Any) -> str:
        return context.launch_configurations[self.name]


def item(name: str, *needed: str, **defaults: Any) -> type:
    """Return a class of items that are described by those words and no others."""
    return make_dataclass(name, [*needed, *((key, Any, value) for key, value in defaults.items())])


LaunchContext: Any = item('LaunchContext', 'launch_configurations', is_shutdown=False)
OpaqueFunction = item('OpaqueFunction', 'function')
ExecuteProcess = item('ExecuteProcess', 'cmd', 'name', 'output', 'on_exit')
ParameterValue = item('ParameterValue', 'value', 'value_type')
OF_ARGUMENTS = 'name', 'default_value', 'description'
DeclareLaunchArgument = item('DeclareLaunchArgument', *OF_ARGUMENTS, choices=None)
RESPAWN = {'respawn': False, 'respawn_delay': 0.0, 'respawn_max_retries': -1}
OF_NODES = {'namespace': '', **dict.fromkeys(('parameters', 'arguments', 'ros_arguments'), ())}
Node: Any = item('Node', 'package', 'executable', 'output', **OF_NODES, on_exit=None, **RESPAWN)


@dataclass
class LaunchDescription:
    entities: list[Any]

    def started(self, pushed: str | None = None, **arguments: str) -> list[Any]:
        """Return what starts for the given arguments, within a PushROSNamespace."""
        declared = {e.name: e for e in self.entities if isinstance(e, DeclareLaunchArgument)}
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
OTHERS = 'robot_state_publisher', 'rviz2'
EXECUTABLES = {'tdm_planner': [*MODULES, 'tdm'], **{name: [name] for name in OTHERS}}


def installed(prefix: Path, packages: Mapping[str, Mapping[str, str]]) -> Path:
    """Install programs with their text as colcon does, by package; this one's files are there."""
    index = prefix / 'share/ament_index/resource_index/packages'
    index.mkdir(parents=True)
    (prefix / 'share/tdm_planner').symlink_to(SOURCE)
    for package, programs in packages.items():
        (index / package).touch()
        (prefix / 'lib' / package).mkdir(parents=True)
        for name, text in programs.items():
            program = prefix / 'lib' / package / name
            program.write_text(text)
            program.chmod(0o755)
    return prefix


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Put the stand-ins in place, and programs, which do nothing, where ROS 2 looks for them."""
    programs = {package: dict.fromkeys(names, '') for package, names in EXECUTABLES.items()}
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(installed(tmp_path / 'ros', programs)))
    for name, classes in OURS.items():
        module = ModuleType(name)
        vars(module).update({made.__name__: made for made in classes})
        monkeypatch.setitem(sys.modules, name, module)
    # Which of them it was imported with must not outlive the test.
    monkeypatch.delitem(sys.modules, 'tdm_planner.launching', raising=False)


def described(name: str) -> LaunchDescription:
    made = runpy.run_path(f'{SOURCE}/launch/{name}.launch.py')['generate_launch_description']()
    assert isinstance(made, LaunchDescription)
    return made
