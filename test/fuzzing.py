# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What must become of whatever is handed over (fuzz_inputs.py): a result, or a reason.

fuzz_corpus.json holds every case that ever escaped, with what it did. `PROPERTIES` are tried by
test/unit/test_fuzz.py with few cases, always the same, by test/nightly with many new ones.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
import json
from pathlib import Path
import signal
import tempfile
from typing import Any

import fuzz_inputs
from fuzz_inputs import message, PROBLEMS, SPECIFICATIONS, TRACKERS
from hypothesis import given, HealthCheck, Phase, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.exceptions import Infeasible, InvalidProblem, TdmError
from tdm_planner.nodes import reading
from tdm_planner.parameter_files import read_parameters
from tdm_planner.parameters import build, flatten, shown, specifications
from tdm_planner.plant_kind import PENDULUM, ROBOT
from tdm_planner.problems import PendulumSwingUp, Solution
from tdm_planner.tracking.motion import TrajectoryRejected
from tdm_planner.tracking.pendulum_tracking import PendulumTracker
from tdm_planner.tracking.robot_tracking import RobotTracker

DEADLINE = 0.05  # s a search may take in these tests
ALLOWANCE = 4.0  # s of processor time beyond it: the step under way, the check, the interpreter
MADE = {'pendulum': PendulumTracker, 'robot': RobotTracker}
KINDS = {'pendulum': PENDULUM, 'robot': ROBOT}


def read_state(plant: str, value: Any) -> np.ndarray:
    kind, found = KINDS[plant], {}
    if kind.odometry:
        moved, value = value
        found = reading.read_odometry(kind, message('nav_msgs/Odometry', moved))
    joints = message('sensor_msgs/JointState', value)
    found |= reading.read_joints(kind.measured, joints, kind.state_names)
    return np.array([found[name] for name in kind.state_names])


def live_through(history: dict[str, Any]) -> bool:
    """Only refusals are raised, commands are finite and within limits; tells of accepted plans."""
    plant, accepted = history['plant'], False
    kind, parameters = KINDS[plant], TRACKERS[plant]
    flat = {k: v for k, v in history['parameters'].items() if k in specifications(parameters)}
    try:
        tracker = MADE[plant](build(parameters, flat))
    except InvalidProblem:
        return False
    limits = [getattr(tracker.parameters.limits, name) for name in kind.control_names]
    for event, now, *rest in history['events']:
        try:
            if event.endswith('state'):
                state = read_state(plant, *rest) if rest else np.zeros(len(kind.state_names))
                assert np.isfinite(state).all(), state
                tracker.observe(state, now)
            elif event == 'plan':
                plan = message('trajectory_msgs/JointTrajectory', rest[0])
                tracker.accept(reading.read_plan(kind, plan), rest[1], now)
                accepted = True
        except (InvalidProblem, TrajectoryRejected) as refusal:
            assert len(str(refusal).splitlines()) == 1
        control = tracker.command(now).control
        assert np.isfinite(control).all(), control
        assert (abs(control) <= limits).all(), control
        assert plant == 'pendulum' or control[0] >= 0.0
    return accepted


class Hang(BaseException):
    """A case took far longer than it may; no handler of errors must swallow it."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Interrupt what takes more than `seconds` of processor time: other load does not count."""

    def interrupt(number: int, frame: Any) -> None:
        raise Hang(f'more than {seconds:g} s of processor time')

    before = signal.signal(signal.SIGPROF, interrupt)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def outcome(act: Callable[[], Any], case: Any, seconds: float = DEADLINE + ALLOWANCE) -> Any:
    """Return what `act` returns, or the package's own error; all else is an escape of `case`."""
    try:
        with limited(seconds):
            return act()
    except TdmError as error:
        assert 0 < len(str(error)) < 2000, (len(str(error)), case)
        assert '\n' not in str(error), (str(error), case)
        return error
    except (Exception, Hang) as error:  # noqa: B902
        raise AssertionError(
            f'{type(error).__name__}: {str(error)[:300]}\nto be kept in test/fuzz_corpus.json: '
            + json.dumps(case, default=repr)[:4000]
        ) from error


def planned(problem: str, parameters: Any, deadline: float = DEADLINE) -> Solution | TdmError:
    """Plan with a short deadline; a solution must be verified, a refusal must name its cause."""
    case, make = {'problem': problem, 'parameters': parameters}, PROBLEMS[problem].from_parameters
    solve = lambda: make(parameters).solve(deadline=deadline, seed=0)  # noqa: E731
    found = outcome(solve, case, deadline + ALLOWANCE)
    if isinstance(found, Solution):
        assert found.verification.ok
        assert json.dumps(found.to_dict(), allow_nan=False)
    elif isinstance(found, InvalidProblem):
        _names_a_field(problem, parameters, str(found))
    else:
        assert isinstance(found, Infeasible), found
    return found


def _names_a_field(problem: str, parameters: Mapping[str, Any], sentence: str) -> None:
    flat: list[str] = []
    with suppress(InvalidProblem):
        flat = list(flatten(parameters))
    names = {shown(str(name)) for name in [*parameters, *flat]} | set(SPECIFICATIONS[problem])
    groups = {name.rsplit('.', 1)[0] + '.*' for name in names if '.' in name}
    known = names | groups | {name.split('.')[0] for name in names if '.start.' in name}
    assert any(f"'{name[:77]}" in sentence or f' {name} ' in sentence for name in known), sentence


def refused_by_name(case: tuple[str, str, Any]) -> None:
    problem, name, value = case
    error = outcome(lambda: PROBLEMS[problem].from_parameters({name: value}), case)
    assert isinstance(error, InvalidProblem), (name, value, error)
    assert name in str(error) or (name == 'robots' and "'robots'" in str(error))


def read_file(content: str | bytes) -> Any:
    data = content if isinstance(content, bytes) else content.encode('utf-8', 'surrogatepass')
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'parameters.yaml')
        path.write_bytes(data)
        make = PendulumSwingUp.from_parameters
        return outcome(lambda: make(read_parameters(path)), repr(content))


def read_setting(text: str) -> Any:
    outcome(lambda: read_parameters(None, [text]), text)
    return outcome(lambda: read_parameters(None, [f'start.psi={text}']), text)


def becomes(act: Callable[[Any], Any], kind: type, case: Any) -> bool:
    found = outcome(lambda: act(case), case)
    assert isinstance(found, (kind, InvalidProblem)), found
    return isinstance(found, kind)


def survived(history: dict[str, Any]) -> bool:
    return bool(outcome(lambda: live_through(history), history))


# By name: the cases, what is checked of each, how many a quick run makes.
PROPERTIES: dict[str, tuple[st.SearchStrategy[Any], Callable[[Any], Any], int]] = {
    **{kind: (fuzz_inputs.parameter_sets(SPECIFICATIONS[kind]), partial(planned, kind), 20)
       for kind in PROBLEMS},
    'forbidden settings': (fuzz_inputs.forbidden_settings(), refused_by_name, 60),
    'no mappings': (fuzz_inputs.anything,
                    partial(becomes, PendulumSwingUp.from_parameters, PendulumSwingUp), 60),
    'files': (fuzz_inputs.yaml_texts, partial(becomes, read_file, PendulumSwingUp), 60),
    'bytes': (st.binary(max_size=60), partial(becomes, read_file, PendulumSwingUp), 30),
    'settings': (fuzz_inputs.yaml_texts, partial(becomes, read_setting, dict), 30),
    **{f'{plant} trackers': (fuzz_inputs.histories(plant), survived, 40) for plant in TRACKERS},
}  # fmt: skip


def tried(made: Any, check: Callable[[Any], Any], cases: int, *, new: bool = False) -> list[Any]:
    """Return outcomes of so many cases: always the same, or new ones, which are not shrunk."""
    outcomes = []

    @settings(
        max_examples=cases, deadline=None, derandomize=not new, database=None, print_blob=True,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.explicit, Phase.generate, *([] if new else [Phase.shrink])],
    )  # fmt: skip
    @given(made)
    def holds(case: Any) -> None:
        outcomes.append(check(case))

    holds()
    return outcomes


def try_out(name: str, factor: int = 1) -> None:
    """Try so many times as many new cases of a property, or the few that are always the same."""
    if name.endswith('trackers'):
        pytest.importorskip('rclpy')
    *property_, cases = PROPERTIES[name]
    taken = tried(*property_, cases * factor, new=factor > 1)
    assert True in taken or False not in taken, 'whoever refuses everything would pass'


def corpus(kind: str) -> list[Any]:
    """Return the cases of a kind as parameters of a test, named for what they once did."""
    entries = json.loads(Path(__file__).with_name('fuzz_corpus.json').read_text(encoding='utf-8'))
    return [pytest.param(e['case'], id=f'{k}: {e["was"]}') for k, e in enumerate(entries[kind])]
