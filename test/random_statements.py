# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Random statements of problems, sound or not: a plan that a replay confirms, or one sentence."""

from dataclasses import dataclass
from time import process_time
from types import SimpleNamespace

from fuzzing import limited
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tdm_planner.direct_method import Duration, Integrated, nonlinear_program, Output
from tdm_planner.exceptions import Infeasible, InvalidProblem
from tdm_planner.parameters import parameter
from tdm_planner.problems import DirectProblem

DEADLINE, ALLOWANCE = 1.0, 1.0  # s; a new kind is traced and its programs made, beside

FORCES = {
    'none': lambda x, v: 0.0 * x,
    'spring': lambda x, v: -2.0 * x,
    'pendulum': lambda x, v: -3.0 * np.sin(x),
    'drag': lambda x, v: -0.3 * v * np.sqrt(v**2 + 1e-3),
    'friction': lambda x, v: -0.2 * np.tanh(20.0 * v),
    'wind': lambda x, v: 0.5 * np.exp(-(x**2)),
    'root': lambda x, v: 0.2 * np.sqrt(x + 0.5),  # not a number for x < -0.5
    'wall': lambda x, v: np.where(x > 0.5, -1.0, 0.0),
}
COSTS = {
    'time': ('final', lambda t, x, u: t),
    'effort': ('running', lambda t, x, u: u[0] ** 2),
    'fuel': ('running', lambda t, x, u: np.abs(u[0])),
    'height': ('final', lambda t, x, u: -x[0]),
    'steps': ('running', lambda t, x, u: np.floor(3.0 * u[0])),
    'mean': ('running', lambda t, x, u: np.mean(u[0] ** 2)),
    'endless': ('final', lambda t, x, u: -t),
    'nothing': ('running', lambda t, x, u: 0.0 * t),
}
LIMITS = {
    'speed': lambda t, x, u: 1.5 - x[1] ** 2,
    'place': lambda t, x, u: 1.2 - x[0],
    'hole': lambda t, x, u: (x[0] - 0.5) ** 2 - 0.01,
    'late': lambda t, x, u: x[0] + 2.0 - 0.1 * t,
    'constant': lambda t, x, u: -1.0,
    'power': lambda t, x, u: 2.0 - u[0] * x[1],
    'infinite': lambda t, x, u: 1.0 / (x[1] - x[1]),
}
MISTAKES = (*['none'] * 12, 'sign', 'count', 'order', 'names', 'raises')


@dataclass(frozen=True)
class Stated(DirectProblem):
    """A cart under some force, in one of three forms."""

    state_names, state_units = ('x', 'v'), ('m', 'm/s')
    control_names, control_units = ('u',), ('N',)
    force: str = parameter('none', 'the force on it')
    cost: str = parameter('time', 'the performance index')
    limits: str = parameter('', 'names of limits, with spaces')
    mistake: str = parameter('none', 'what is wrong')
    integrated_states: bool = parameter(False, 'outputs: the acceleration, not the place')
    mass: float = parameter(1.0, 'mass')
    largest: float = parameter(2.0, 'largest control')
    start: float = parameter(0.0, 'place to start from')
    speed: float = parameter(0.0, 'speed to start with')
    goal: float = parameter(1.0, 'place to reach')
    guess: float = parameter(2.0, 'time')
    fixed: bool = parameter(False, 'whether the time is fixed')
    degree: int = parameter(0, 'of the speed factor')
    free: int = parameter(4, 'varied parameters')

    def outputs(self):
        if self.integrated_states:
            return {'u': Output(free=self.free, derivatives=0, scale=1.0)}
        end = (self.goal, 0.0, 0.0, 1.0) if self.mistake == 'order' else (self.goal, 0.0)
        return {'x': Output((self.start, self.speed), end, free=self.free)}

    def integrated(self):
        both = {'x': Integrated(self.start, self.goal), 'v': Integrated(self.speed, 0.0)}
        return both if self.integrated_states else {}

    def duration(self):
        return Duration(self.guess, fixed=self.fixed, speed_factor_order=self.degree)

    def invert(self, y, z):
        if self.integrated_states:
            return (z['x'], z['v']), y['u']
        x, v, a = y['x']
        return (x, v), (self.mass * a - FORCES[self.force](x, v),)

    def derivative(self, x, u):
        if self.mistake == 'raises':
            return 1 / 0
        force = -1.0 if self.mistake == 'sign' else FORCES[self.force](x[0], x[1])
        rates = x[1], (u[0] + force) / self.mass
        return rates[:1] if self.mistake == 'count' else rates

    def margins(self, t, x, u):
        return {name: LIMITS[name](t, x, u) for name in self.limits.split()}

    def control_limits(self):
        name = 'force' if self.mistake == 'names' else 'u'
        return {name: (-self.largest, self.largest)}

    def running_cost(self, t, x, u):
        kind, function = COSTS[self.cost]
        return function(t, x, u) if kind == 'running' else 0.0 * t

    def final_cost(self, t, x):
        kind, function = COSTS[self.cost]
        return function(t, x, None) if kind == 'final' else 0.0 * t


one, real = st.sampled_from, st.floats
STATEMENTS = st.fixed_dictionaries({
    'force': one(list(FORCES)), 'cost': one(list(COSTS)), 'mistake': one(MISTAKES),
    'limits': st.lists(one(list(LIMITS)), unique=True, max_size=2).map(' '.join),
    'mass': real(0.1, 10.0), 'largest': real(0.0, 20.0), 'guess': real(0.05, 20.0),
    'start': real(-3.0, 3.0), 'speed': real(-2.0, 2.0), 'goal': real(-3.0, 3.0),
    **dict.fromkeys(('integrated_states', 'fixed', 'solver.refine'), st.booleans()),
    'degree': one([0, 0, 1, 3]), 'free': st.integers(0, 8),
})  # fmt: skip


def check_replay(problem: Stated, plan) -> None:
    """Integrate the statement by other means than the package's, piece by piece."""
    motion = plan.trajectory
    x, worst = motion.states[0], dict[str, float]()
    for begin, end in zip(motion.times[:-1], motion.times[1:], strict=True):

        def rates(t: float, x) -> list[float]:
            u = motion.sample(t).control
            return [float(rate) for rate in problem.derivative(np.array(x), u)]

        times = np.linspace(begin, end, 5)
        found = solve_ivp(rates, (begin, end), x, t_eval=times, rtol=1e-8, atol=1e-10)
        assert found.success
        for t, state in zip(times, found.y.T, strict=True):
            u = motion.sample(min(t, motion.duration)).control
            every = problem.margins(t, state, u) | {'u': problem.largest - abs(u[0])}
            worst = {k: min(worst.get(k, np.inf), float(v)) for k, v in every.items()}
        x = found.y[:, -1]
    allowed = 2e-3 * np.ptp(motion.states, axis=0) + 1e-5
    assert (np.abs(x - [problem.goal, 0.0]) <= allowed).all(), x
    assert all(value >= -1e-4 * (1.0 + problem.largest) for value in worst.values()), worst


def outcome_of(case: dict) -> bool:
    """Return whether there is a plan; a refusal is a sentence, a plan is replayed."""
    problem = Stated.from_parameters(case)
    try:
        with limited(DEADLINE + ALLOWANCE), pytest.MonkeyPatch.context() as patch:
            # The deadline counts processor time, too: the machine may be busy.
            patch.setattr(nonlinear_program, 'time', SimpleNamespace(perf_counter=process_time))
            plan = problem.solve(deadline=DEADLINE)
    except (InvalidProblem, Infeasible) as error:
        assert '\n' not in str(error)
        assert 10 < len(str(error)) < 500, str(error)
        return False
    sound = case['mistake'] in ('none', 'order') or case['force'] == 'wall'
    assert sound or case['integrated_states']
    check_replay(problem, plan)
    return True
