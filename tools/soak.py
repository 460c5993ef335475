# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Fly demo missions back to back for hours: does memory grow, is one missed.

    python -m tools.soak --hours 1 [-o FOLDER] [--real-time LEVEL]

One pendulum and three robots, each with planner, trackers and plants as processes that live all
along, fly their demo in turn: the plants are reset, a plan is asked for, carried out and judged as
`tdm demo` judges it. Meanwhile the resident memory of every process is sampled. FOLDER gets
soak.json, soak.png and the nodes' logs. The exit code is 0 if every mission reached its goal and
no node's memory grew by 1 MB/h or more after the warm-up. On a machine
that does other things besides, --real-time (as root) sees to it that the nodes get their time.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
import itertools
import json
import os
from pathlib import Path
import platform
import signal
import sys
import time
from typing import Any

from tdm_planner.exceptions import TdmError
from tdm_planner.parameter_files import read_parameters
from tdm_planner.resources import config_file
from tdm_sim.demo import SCENES
from tdm_sim.demo_scene import Scene
from tdm_sim.processes import NodeProcesses
from tdm_sim.progress import make_progress, Progress
from tools.memory import HOUR, MemoryRecord
from tools.missions import MissionControl, MissionFailed, Outcome
from tools.priority import make_real_time

LARGEST_GROWTH = 1.0  # MB/h
SAMPLING = 5.0  # s
THIS = 'mission control'
ROBOT_RATE = 50.0  # Hz; ten nodes at 200 Hz are more than two cores can do besides other work
_WARM_UP = 600.0  # s; of short runs a third
_DOMAIN = '73'


@dataclass
class Soak:
    """What is known so far; `began` is the instant [s] of the first mission."""

    duration: float
    warm_up: float
    began: float = field(default_factory=time.time)
    memory: MemoryRecord = field(default_factory=MemoryRecord)
    missions: list[Outcome] = field(default_factory=list)

    @property
    def elapsed(self) -> float:
        """Time since the beginning [s]."""
        return time.time() - self.began

    @property
    def missed(self) -> list[Outcome]:
        """Missions that did not reach their goal."""
        return [mission for mission in self.missions if not mission.reached]

    @property
    def growing(self) -> dict[str, float]:
        """Return the nodes whose memory grows too fast, or is not known [MB/h]."""
        growth = self.memory.growth(self.warm_up)
        return {
            name: slope
            for name, slope in growth.items()
            if name != THIS and not slope < LARGEST_GROWTH  # this program keeps a record
        }

    def to_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        return {
            'began': datetime.fromtimestamp(self.began, timezone.utc).isoformat(),
            'machine': machine(),
            'seconds': self.elapsed,
            'warm_up': self.warm_up,
            'missions': len(self.missions),
            'missed': len(self.missed),
            'growth [MB/h]': self.memory.growth(self.warm_up),
            'times': self.memory.times,
            'resident memory [MB]': self.memory.sizes,
            'flown': [mission.to_dict() for mission in self.missions],
        }

    def table(self) -> str:
        """Return the figures as lines of text."""
        by_scene = {
            name: [m for m in self.missions if m.scene == name]
            for name in sorted({mission.scene for mission in self.missions})
        }
        lines = [
            f'{name}: {len(flown)} missions, {sum(not m.reached for m in flown)} missed'
            for name, flown in by_scene.items()
        ]
        lines.append(f'{"resident memory [MB]":28}{"warmed up":>10}{"at the end":>11}{"MB/h":>8}')
        first = next((k for k, t in enumerate(self.memory.times) if t >= self.warm_up), -1)
        growth = self.memory.growth(self.warm_up)
        for name, sizes in self.memory.sizes.items():
            lines.append(f'{name:28}{sizes[first]:10.1f}{sizes[-1]:11.1f}{growth[name]:8.2f}')
        return '\n'.join(lines)


def machine() -> str:
    """Return the machine in a few words."""
    return f'{os.cpu_count()} CPUs, {platform.machine()}, Linux {platform.release()}'


def soak(
    duration: float,
    folder: Path,
    progress: Progress,
    scenes: Sequence[str] = tuple(SCENES),
    rate: float = ROBOT_RATE,
    real_time: int = 0,
) -> Soak:
    """
    Fly missions for `duration` s; writes soak.json after each.

    Raises
    ------
    ProcessFailed, MissionFailed
        If a node ended or did not come up.

    """
    folder.mkdir(parents=True, exist_ok=True)
    # Not in another's domain by mistake; whoever wants to listen knows where.
    os.environ.setdefault('ROS_DOMAIN_ID', _DOMAIN)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_LOG_DIR', str(folder / 'log' / 'ros'))
    made = {name: _scene(name) for name in scenes}
    record = Soak(duration, min(_WARM_UP, duration / 3))
    with NodeProcesses(folder / 'log') as processes:
        for plant, scene in made.items():
            for name, module, arguments in scene.nodes():
                if 'planner' not in name and plant == 'robots':
                    arguments += ['-p', f'rate:={rate}']
                processes.start(_full_name(scene, name), module, arguments)
        make_real_time(processes.identifiers, real_time)
        next_sample = 0.0

        def look() -> None:
            nonlocal next_sample
            now = record.elapsed
            if now >= next_sample:
                next_sample = now + SAMPLING
                # This process as well: what its client library holds.
                record.memory.sample(now, {**processes.identifiers, THIS: os.getpid()})
            progress.update(_line(record))

        with MissionControl(made, processes, look) as control:
            progress.phase(f'starting {len(processes.identifiers)} nodes')
            control.wait_for_nodes()
            record.began = time.time()
            record.memory = MemoryRecord()
            next_sample = 0.0
            for name in itertools.cycle(made):
                if record.elapsed > duration:
                    break
                mission = control.fly(name)
                record.missions.append(mission)
                outcome = 'reached' if mission.reached else f'MISSED: {"; ".join(mission.reasons)}'
                progress.phase(f'{_line(record)}; last: {name} {outcome}')
                _write(record, folder)
        codes = processes.end()
    for name, code in codes.items():
        if code:
            raise MissionFailed(f'{name} ended with exit code {code}')
    return record


def _scene(name: str) -> Scene:
    file = config_file(f'{name}.yaml').resolve()
    return SCENES[name](read_parameters(file), file)


def _full_name(scene: Scene, name: str) -> str:
    plant = scene.namespace.strip('/')
    return name if plant in name else f'{plant}_{name}'


def _line(record: Soak) -> str:
    total = sum(sizes[-1] for sizes in record.memory.sizes.values())
    return (
        f'{record.elapsed / 60:5.1f} of {record.duration / 60:g} min, '
        f'{len(record.missions)} missions, {len(record.missed)} missed, {total:.0f} MB in all'
    )


def _write(record: Soak, folder: Path) -> None:
    whole = folder / 'soak.json.part'
    whole.write_text(json.dumps(record.to_dict(), indent=1) + '\n')
    whole.replace(folder / 'soak.json')


def draw(record: Soak, path: Path) -> None:
    """Write a picture of the memory of every process over time."""
    import matplotlib
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), layout='constrained')
    axes = figure.add_subplot()
    axes.set_prop_cycle(color=list(matplotlib.colormaps['tab20'](range(20))))
    growth = record.memory.growth(record.warm_up)
    minutes = [time / 60 for time in record.memory.times]
    for name, sizes in record.memory.sizes.items():
        axes.plot(minutes, sizes, label=f'{name}: {growth[name]:+.2f} MB/h')
    axes.axvline(record.warm_up / 60, color='grey', linestyle=':', label='warmed up')
    axes.set_xlabel('time [min]')
    axes.set_ylabel('resident memory [MB]')
    axes.set_title(f'{len(record.missions)} missions, {len(record.missed)} missed')
    axes.legend(fontsize='small', loc='center left', bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=100)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or '').strip().split('\n')[0],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument('--hours', type=float, default=1.0, help='how long')
    parser.add_argument('--scenes', nargs='+', choices=SCENES, default=list(SCENES))
    parser.add_argument(
        '--robot-rate', type=float, default=ROBOT_RATE, help='of states and commands [Hz]'
    )
    parser.add_argument(
        '--real-time', type=int, default=0, metavar='LEVEL', help='real-time priority (0: none)'
    )
    parser.add_argument('-o', '--output', type=Path, default=Path('soak'), metavar='FOLDER')
    given = parser.parse_args(arguments)
    for number in (signal.SIGINT, signal.SIGTERM):  # in the background SIGINT is ignored
        signal.signal(number, signal.default_int_handler)
    with make_progress() as progress:
        try:
            record = soak(
                given.hours * HOUR,
                given.output,
                progress,
                given.scenes,
                given.robot_rate,
                given.real_time,
            )
        except (MissionFailed, TdmError) as error:
            print(f'soak: {error}', file=sys.stderr)
            return 1
    _write(record, given.output)
    draw(record, given.output / 'soak.png')
    print(record.table())
    for mission in record.missed:
        print(f'soak: a mission of {mission.scene} was missed: {"; ".join(mission.reasons)}',
              file=sys.stderr)  # fmt: skip
    for name, slope in record.growing.items():
        print(f'soak: the memory of {name} grows by {slope:.2f} MB/h', file=sys.stderr)
    return int(bool(record.missed or record.growing))


if __name__ == '__main__':
    sys.exit(main())
