# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What trackers have in common: parameters, phases, commands, and the plans that they follow."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
import math
from typing import Any, ClassVar, TypeVar

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.exceptions import TdmError
from tdm_planner.parameters import group, LARGEST, parameter, positive, Range, Validated
from tdm_planner.plants.base import Named
from tdm_planner.trajectory import T, TimedTrajectory, Trajectory

_SLOWEST = 12.0  # commands, at least, while a deviation without feedback grows e-fold
_LIMIT_SLACK = 1e-3  # share of the numbers, by which a plan may be beyond a tracker's limits
_LATEST_START = 7200.0  # s ahead: a stamp beyond is that of another clock
_LONGEST_MOTION = 3600.0  # s for which gains are prepared
CLOCK_TOLERANCE = 1e-3  # s; what the clock may be set back without a word
_MESSAGE_ROUNDING = 1e-9  # s, and in units of states and controls

Made = TypeVar('Made')
Steps = Generator[None, None, Made]  # a computation of milliseconds a step; commands go on between
NOISE = Range(1e-9, 1e6)  # of standard deviations; their squares are computed with


@dataclass(frozen=True)
class Tolerances(Validated):
    """How far the pendulum may be from the trajectory; others have their own."""

    start: float = positive(
        0.3, 'largest deviation at the start for a trajectory to be accepted', 'rad'
    )
    path: float = positive(1.0, 'deviation from the plan at which the motion is aborted', 'rad')


@dataclass(frozen=True)
class ReplanOnDeviation(Validated):
    """What happens when the motion is aborted."""

    on_deviation: bool = parameter(
        False, 'when the motion is aborted, bring the plant to rest and ask for a new plan'
    )
    interval: float = positive(1.0, 'time from the answer to such a request until the next', 's')


@dataclass(frozen=True)
class TrackerParameters(Validated):
    """Parameters of every tracker; subclasses add the plant's own."""

    rate: float = parameter(
        200.0, 'rate of the commands', unit='Hz', allowed=Range(1.0, 1000.0), read_only=True
    )
    state_timeout: float = parameter(
        0.1,
        'age of the newest state beyond which zero is commanded',
        unit='s',
        allowed=Range(0.0, 10.0, lower_open=True),
    )
    command_delay: float = parameter(
        0.0,
        'initial guess of the time from a command to its effect; the estimate stays within '
        '0.01 s of it',
        unit='s',
        allowed=Range(0.0, 1.0),
    )
    planner_service: str = parameter('plan', "name of the planner's service", read_only=True)
    tolerance: Tolerances = group(Tolerances)
    replan: ReplanOnDeviation = group(ReplanOnDeviation)

    @property
    def interval(self) -> float:
        """Time for which a command acts [s]."""
        return 1.0 / self.rate

    def too_slow(self, growth_rate: float) -> str:
        """Tell that commands are too slow where deviations grow at that rate [1/s], '' if not."""
        rate, least = self.rate, _SLOWEST * growth_rate
        slow = f'rate = {rate:g} Hz is too slow for this plant: must be {least:.0f} Hz or more'
        return slow if rate < least else ''


class TrajectoryRejected(TdmError):
    """A trajectory cannot be tracked; the active one stays. The message is one sentence."""

    code: ClassVar[str] = 'TRAJECTORY_REJECTED'


class TrajectoryMissed(TrajectoryRejected):
    """It could have been tracked, but the plant is elsewhere, or it is over."""


class Phase(str, Enum):
    """What a tracker is doing, as it knows itself; see `tracker.py`."""

    IDLE = 'idle'
    WAITING = 'waiting'
    TRACKING = 'tracking'
    HOLDING = 'holding'
    STOPPED = 'stopped'
    RECOVERING = 'recovering'


class ObservedPhase(str, Enum):
    """What a planner knows of a tracker's `Phase`, from the tracker's status."""

    FOLLOWING = 'following'  # tracking or holding: the active plan, or its goal
    RECOVERING = 'recovering'  # the plan was aborted, the plant is brought to rest
    IDLE = 'idle'  # idle, waiting or stopped: taken to command nothing


@dataclass(frozen=True, eq=False)
class Action:
    """
    A feedback law's answer: `control` (nu,), and the `feedback` (nu,) within it.

    `error` (nx,) is the state minus the planned one, angles the shorter way round.
    """

    control: Array
    feedback: Array
    error: Array


@dataclass(frozen=True, eq=False)
class Command:
    """
    What a tracker commands for the coming interval; `action` is None where no law is at work.

    `problem` is a sentence where something is wrong, else empty.
    """

    control: Array
    phase: Phase
    action: Action | None = None
    problem: str = ''


@dataclass(frozen=True, eq=False)
class Motion(TimedTrajectory):
    """
    A plan that a tracker has accepted; `law` is what a subclass prepared for it.

    It is followed `late` s after its time, `pace` times as fast as planned: 0 and 1, unless the
    tracker waits for the plant or hurries after it. `reached` says whether its goal was reached in
    time, None as long as that is open.
    """

    law: Any
    late: float = 0.0
    pace: float = 1.0
    reached: bool | None = None

    @property
    def end(self) -> float:
        """Instant of the last sample [s]."""
        return self.start + self.late + self.trajectory.duration / self.pace

    def elapsed(self, time: T) -> T:
        """How far the plan has come at instant(s) [s]: seconds of the plan since its start."""
        return self.pace * (time - self.start - self.late)

    def is_of(self, trajectory: Trajectory) -> bool:
        """Whether it is the very trajectory, whenever that starts."""
        own = self.trajectory
        return own.states.shape == trajectory.states.shape and all(
            np.allclose(getattr(own, part), getattr(trajectory, part), 0.0, _MESSAGE_ROUNDING)
            for part in ('times', 'states', 'controls')
        )


def next_step(steps: Steps[Any]) -> None:
    """Take a step; StopIteration ends them. What is not finite is told by errors, not by numpy."""
    with np.errstate(all='ignore'):
        next(steps)


def finished(steps: Steps[Made]) -> Made:
    """Take all steps of a computation at once, and return its result."""
    try:
        while True:
            next_step(steps)
    except StopIteration as end:
        made: Made = end.value
        return made


def check_trajectory(trajectory: Trajectory, start: float, now: float) -> None:
    """
    Check that a trajectory of the plant can be followed from the instant `start` [s] on.

    Raise TrajectoryRejected if it cannot; TrajectoryMissed if it is over.
    """
    if not math.isfinite(start) or start + trajectory.duration <= now:
        since = now - start - trajectory.duration
        raise TrajectoryMissed(
            f'the trajectory lies wholly in the past: it ended {since:.3g} s ago'
        )
    for what, seconds, most in (
        ('starts in', start - now, _LATEST_START),
        ('lasts', trajectory.duration, _LONGEST_MOTION),
    ):
        if seconds > most:
            raise TrajectoryRejected(
                f'the trajectory {what} {seconds:.3g} s: must not be more than {most:g} s'
            )
    largest = max(np.abs(part).max() for part in (trajectory.states, trajectory.controls))
    if largest > LARGEST:
        raise TrajectoryRejected(
            f'the trajectory holds the value {largest:.3g}: must not be beyond {LARGEST:g}'
        )


def beyond_limits(trajectory: Trajectory, limits: Mapping[str, tuple[float, float]]) -> str:
    """Tell that states or controls of a trajectory are beyond a tracker's limits, '' if not."""
    found = []
    for name, (low, high) in limits.items():
        known = trajectory.control if name in trajectory.control_names else trajectory.state
        least, most = float(known(name).min()), float(known(name).max())
        sizes = [abs(value) for value in (least, most, low, high) if math.isfinite(value)]
        slack = _LIMIT_SLACK * max(sizes)
        if least < low - slack or most > high + slack:
            found.append(f'{name} from {least:.3g} to {most:.3g} (limits {low:g}, {high:g})')
    told = 'the trajectory asks for more than the limits of the tracker allow: '
    return told + ', '.join(found) if found else ''


def worst_state(plant: Named, error: Array, parts: Sequence[float]) -> str:
    """Tell by how much the state is off whose part in the deviation is the largest."""
    k = int(np.argmax(parts))
    return f'{plant.state_names[k]} is off by {error[k]:.3g} {plant.state_units[k]}'.rstrip()
