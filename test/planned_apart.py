# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Plans made in processes of their own, as digests: the same request and seed give the same digits.

As in the nodes, one thread does the linear algebra (`tdm_planner.starting.limit_threads`). The
deadlines are long: one that cuts a search short makes the plan depend on the machine's speed.
Used by `unit/problems/test_problems.py` and `nightly/test_packaging.py`.
"""

import json
import os
import subprocess
import sys

from ros_harness import SOURCE

ONE_THREAD = dict.fromkeys(('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'), '1')
CHILD = """
import hashlib, json, sys

sys.path.insert(0, 'docs/plants')
from double_integrator import DoubleIntegrator
from tdm_planner.problems import PendulumSwingUp, RobotFormation

problems = {
    'pendulum, weak': lambda: PendulumSwingUp.from_parameters(
        {'start.theta': 2.5, 'start.psi': 0.1}
    ),
    'pendulum, strong and smooth': lambda: PendulumSwingUp.from_parameters(
        {'limits.torque': 0.2, 'method': 'smooth'}
    ),
    'robots': lambda: RobotFormation.from_parameters({'robot1.start.u': 0.02}),
    'plant of ones own': DoubleIntegrator,
}
found = {}
for name, make in problems.items():
    solution = make().solve(deadline=120.0, seed=7)
    plan = solution.to_dict()
    del plan['solve_time']
    for robot in plan.get('robots', {}).values():
        del robot['solve_time']
    text = json.dumps(plan, sort_keys=True) + str(solution.parameters.tolist())
    found[name] = hashlib.sha256(text.encode()).hexdigest()
print(json.dumps(found))
"""


def planned_apart(**environment: str) -> dict[str, str]:
    """Plan for all problems in a process of its own; a digest of every plan."""
    done = subprocess.run(
        [sys.executable, '-W', 'ignore', '-c', CHILD],
        env={**os.environ, **ONE_THREAD, 'PYTHONPATH': str(SOURCE), **environment},
        cwd=SOURCE,
        stdout=subprocess.PIPE,
        text=True,
        timeout=900,
        check=True,
    )
    found: dict[str, str] = json.loads(done.stdout)
    return found
