# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Plans made in processes of their own, as digests: the same request and seed give the same digits.

As in the nodes, one thread does the linear algebra (`tdm_planner.starting.limit_threads`). The
deadlines are long: one that cuts a search short makes the plan depend on the machine's speed.
"""

import hashlib
import json
import os
import subprocess
import sys

from double_integrator import DoubleIntegrator
from ros_harness import SOURCE
from tdm_planner.problems import PendulumSwingUp, RobotFormation

ONE_THREAD = dict.fromkeys(('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'), '1')
PROBLEMS = {
    'pendulum, weak': (PendulumSwingUp, {'start.theta': 2.5, 'start.psi': 0.1}),
    'pendulum, strong and smooth': (PendulumSwingUp, {'limits.torque': 0.2, 'method': 'smooth'}),
    'robots': (RobotFormation, {'robot1.start.u': 0.02}),
    'plant of ones own': (DoubleIntegrator, {}),
}


def planned_apart(**environment: str) -> dict[str, str]:
    variables = {'PYTHONPATH': f'{SOURCE}{os.pathsep}{SOURCE}/docs/plants', **environment}
    command = [sys.executable, '-W', 'ignore', __file__]
    environment = {**os.environ, **ONE_THREAD, **variables}
    return json.loads(subprocess.check_output(command, env=environment, timeout=900))


if __name__ == '__main__':
    digests = {}
    for name, (kind, given) in PROBLEMS.items():
        solution = kind.from_parameters(given).solve(deadline=120.0, seed=7)
        plan = solution.to_dict()
        for part in (plan, *plan.get('robots', {}).values()):
            del part['solve_time']
        text = json.dumps(plan, sort_keys=True) + str(solution.parameters.tolist())
        digests[name] = hashlib.sha256(text.encode()).hexdigest()
    print(json.dumps(digests))
