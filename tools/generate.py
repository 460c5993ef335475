# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Write what follows from the code: files in config/, tables and a figure of docs/.

make config                         (python -m tools.generate)
python -m tools.generate --check    exit 1 where a file is not up to date
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
import difflib
from pathlib import Path
import sys
from typing import Any

from tdm_planner.problems import RobotFormation
from tools.architecture import figure
from tools.node_tables import parameters_by_node, Specifications
from tools.pages import documentation
from tools.parameter_texts import parameter_file
from tools.security_policy import policy

ROOT = Path(__file__).resolve().parents[1]

Values = Mapping[str, Any]

PENDULUM_TITLE = """Rotary pendulum: planner, tracker and simulated plant, in any namespace.
Written by `make config` from the declarations in the code: the values are the defaults.
The planner's plant and limits are what it believes, the plant node's what is simulated."""

ROBOTS_TITLE = """Robots: one planner, tracker and simulated plant of each robot, in any namespace.
Written by `make config` from the declarations in the code: the values are the defaults, but for
`rate`: motions of many seconds need no more than 100 Hz, and each robot is two processes.
The simulated robots begin at <robot>.start, and after `reset`; those with u, v, omega drift."""

AIR_BEARING_TITLE = """Robots of 10.5 kg on an air-bearing floor, driven by cold gas (slow).
Bevilacqua et al., Int. J. Aerospace Eng. 2011, 308245.
  tdm plan robots --params config/robots_air_bearing.yaml -o plan.json
  ros2 launch tdm_planner robots.launch.py params_file:=config/robots_air_bearing.yaml
Written by `make config` from the declarations in the code."""

# Of the robots' nodes [Hz].
ROBOTS_RATE: Values = {'rate': 100.0}


def pendulum_file() -> str:
    """Return config/pendulum.yaml."""
    declared = parameters_by_node()
    nodes: dict[str, tuple[Specifications, Values]] = {
        'planner': (declared['planner pendulum'], {}),
        'tracker': (declared['tracker pendulum'], {}),
        'pendulum_plant': (declared['pendulum_plant'], {}),
    }
    return parameter_file(nodes, PENDULUM_TITLE)


def robots_file(title: str, planner: Values, actuators: Values) -> str:
    """Return a parameter file for the robots, with values that differ from the defaults."""
    declared = parameters_by_node()
    of_one_robot = ('initial.', 'robot_name')
    plant = {
        name: spec
        for name, spec in declared['robot_plant'].items()
        if not name.startswith(of_one_robot)
    }
    nodes: dict[str, tuple[Specifications, Values]] = {
        'planner': (declared['planner robots'], {'problem': RobotFormation.name, **planner}),
        'tracker': (declared['tracker robot'], {'kind': 'robot', **ROBOTS_RATE, **actuators}),
        'robot_plant': (plant, {**ROBOTS_RATE, **actuators}),
    }
    return parameter_file(nodes, title)


def air_bearing_file() -> str:
    """Return config/robots_air_bearing.yaml."""
    limits: Values = {
        'limits.thrust': 0.315,
        'limits.torque': 0.00189,
        'limits.thruster_rate': 0.5,
    }
    manoeuvre: Values = {
        'arrival_interval': 4.0,
        'weights.time': 0.015,
        'weights.sequence': 0.015,
        'weights.gas': 0.97,
    }
    return robots_file(AIR_BEARING_TITLE, {**limits, **manoeuvre}, limits)


def generated() -> dict[Path, str]:
    """Return every generated file's path and content."""
    config = ROOT / 'config'
    return {
        config / 'pendulum.yaml': pendulum_file(),
        config / 'robots.yaml': robots_file(ROBOTS_TITLE, {}, {}),
        config / 'robots_air_bearing.yaml': air_bearing_file(),
        config / 'security' / 'policy.xml': policy(),
        ROOT / 'docs' / 'images' / 'architecture.svg': figure(),
        **documentation(ROOT / 'docs'),
    }


def main() -> int:
    """Write the files, or check them."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--check', action='store_true', help='write nothing, compare')
    check = parser.parse_args().check
    stale = 0
    for path, wanted in generated().items():
        present = path.read_text(encoding='utf-8') if path.is_file() else ''
        if present == wanted:
            continue
        stale += 1
        if check:
            name = str(path.relative_to(ROOT))
            difference = difflib.unified_diff(
                present.splitlines(), wanted.splitlines(), name, f'{name} (declared)', lineterm=''
            )
            print('\n'.join(difference))
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(wanted, encoding='utf-8')
            print(f'written: {path.relative_to(ROOT)}')
    return int(check and stale > 0)


if __name__ == '__main__':
    sys.exit(main())
