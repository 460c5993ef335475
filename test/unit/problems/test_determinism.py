# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The same request and seed give the same plan to the last bit, whatever the process is like.

That holds where the deadline does not cut the search short: the deadlines here are long.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys

import pytest

SOURCE = Path(__file__).resolve().parents[3]
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
for name in sys.argv[1:] or problems:
    solution = problems[name]().solve(deadline=120.0, seed=7)
    plan = solution.to_dict()
    del plan['solve_time']
    for robot in plan.get('robots', {}).values():
        del robot['solve_time']
    text = json.dumps(plan, sort_keys=True) + str(solution.parameters.tolist())
    found[name] = hashlib.sha256(text.encode()).hexdigest()
print(json.dumps(found))
"""


def plans(*names: str, **environment: str) -> dict[str, str]:
    """Plan for those problems, or all, in a process of its own; a digest of every plan."""
    done = subprocess.run(
        [sys.executable, '-W', 'ignore', '-c', CHILD, *names],
        env={**os.environ, 'PYTHONPATH': str(SOURCE), **environment},
        cwd=SOURCE,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.fixture(scope='module')
def reference() -> dict[str, str]:
    return plans(OPENBLAS_NUM_THREADS='1', PYTHONHASHSEED='0')


@pytest.mark.parametrize(('threads', 'hash_seed'), [('2', '1'), ('4', 'random')])
def test_threads_and_the_order_of_sets_change_nothing(
    reference: dict[str, str], threads: str, hash_seed: str
) -> None:
    variables = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS')
    found = plans(**dict.fromkeys(variables, threads), PYTHONHASHSEED=hash_seed)
    assert found == reference


@pytest.mark.parametrize(
    'name',
    [
        'robots',
        pytest.param(
            'pendulum, weak',
            marks=pytest.mark.skipif(
                os.environ.get('TDM_FUZZ') != 'nightly',
                reason='compiles for a minute: TDM_FUZZ=nightly',
            ),
        ),
    ],
)
def test_kernels_compiled_anew_change_nothing(
    reference: dict[str, str], tmp_path: Path, name: str
) -> None:
    assert plans(name, NUMBA_CACHE_DIR=str(tmp_path))[name] == reference[name]
