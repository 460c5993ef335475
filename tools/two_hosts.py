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
Fly the demos with planner and trackers on one host and the plants on another.

    python -m tools.two_hosts [--links clean bad] [--scenes pendulum robots] [-o FOLDER]

The hosts are network namespaces on this machine (Linux, root and iproute2), joined first by a
clean link, then by one that delays by 20 +- 5 ms and loses 2 %, either way. The pendulum is strong
(limits.torque 0.09 N m); on the bad link the trackers' command_delay is the link's. Told are the
verdict, and what became of the messages under way. The exit code is 0 if every goal was reached,
77 if this machine cannot pretend to be two.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
import json
import os
from pathlib import Path
import shlex
import subprocess
import sys
from types import MappingProxyType
from typing import Any

from tdm_sim.demo import SCENES
from tools.streams import Stream
from tools.two_networks import environment, Hosts, Link, NotPossible, two_hosts, why_not

LINKS: Mapping[str, Link] = MappingProxyType(
    {'clean': Link(), 'bad': Link(delay=0.02, jitter=0.005, loss=0.02)}
)
SETTINGS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        'pendulum': ('limits.torque:=0.09', 'replan.on_deviation:=true'),
        'robots': (),
    }
)
# The feedback has more to do: it is left more of the torque.
ON_BAD_LINKS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {'pendulum': ('torque_reserve:=0.5',), 'robots': ()}
)
SKIPPED = 77
LONGEST = 240.0  # s


def fly(
    scene: str, link: Link, folder: Path, settings: Sequence[str] = (), real_time: int = 0
) -> dict[str, Any]:
    """
    Fly one demo over a link and return what is to be told of it.

    Raises
    ------
    NotPossible
        If this machine cannot make two hosts.
    RuntimeError
        If the mission could not be carried out; says why.

    """
    if not link.clean:
        settings = (f'command_delay:={link.delay:g}', *ON_BAD_LINKS[scene], *settings)
    with two_hosts(link, real_time) as hosts:
        found = _run(scene, hosts, folder, settings, real_time)
        return {'link': str(link), 'made by': hosts.made_by, **found}


def _run(
    scene: str, hosts: Hosts, folder: Path, settings: Sequence[str], real_time: int
) -> dict[str, Any]:
    command = [
        *hosts.plants.within,
        *(sys.executable, '-m', 'tools.mission_apart', scene, str(folder)),
        *('--control', shlex.join(hosts.control.within)),
        *('--real-time', str(real_time)),
        *(word for setting in (*SETTINGS[scene], *settings) for word in ('-p', setting)),
    ]
    process = subprocess.Popen(
        command,
        env={**os.environ, **environment()},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        said = process.communicate(timeout=LONGEST)[1]
    except subprocess.TimeoutExpired:
        process.terminate()
        raise RuntimeError(f'the mission had no end after {LONGEST:g} s') from None
    if process.returncode:
        raise RuntimeError(said.strip().rsplit('\n', 1)[-1])
    found: dict[str, Any] = json.loads((folder / 'mission.json').read_text())
    return found


def text(found: Mapping[str, Any]) -> str:
    """Return what is to be told of a mission as lines of text."""
    outcome = 'reached and held' if found['reached'] else f'MISSED: {"; ".join(found["reasons"])}'
    lines = [f'{found["scene"]}, link {found["link"]}: {outcome}', f'  ({found["made by"]})']
    lines += [f'  {name}: {figure}' for name, figure in found['achieved'].items()]
    for plant, errors in found['tracking'].items():
        largest = ', '.join(f'{error:.3g}' for error in errors)
        lines.append(f'  largest tracking errors of {plant}: {largest}')
    lines += [f'  {topic}: {Stream(**figures)}' for topic, figures in found['streams'].items()]
    return '\n'.join(lines + [f'  {sentence}' for sentence in found['unclean']])


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or '').strip().split('\n')[0],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument('--links', nargs='+', choices=LINKS, default=list(LINKS))
    parser.add_argument('--scenes', nargs='+', choices=SCENES, default=list(SCENES))
    parser.add_argument(
        '-p', dest='settings', action='append', default=[], metavar='NAME:=VALUE',
        help='a further parameter of trackers, and of plants and planner where they have it',
    )  # fmt: skip
    parser.add_argument(
        '--real-time', type=int, default=0, metavar='LEVEL', help='real-time priority (0: none)'
    )
    parser.add_argument('-o', '--output', type=Path, default=Path('two_hosts'), metavar='FOLDER')
    given = parser.parse_args(arguments)
    reason = why_not()
    if reason:
        print(f'two_hosts: skipped: {reason}', file=sys.stderr)
        return SKIPPED
    missed = 0
    for scene in given.scenes:
        for name in given.links:
            try:
                folder = given.output / f'{scene}_{name}'
                found = fly(scene, LINKS[name], folder.resolve(), given.settings, given.real_time)
            except (NotPossible, RuntimeError) as error:
                print(f'two_hosts: {scene}, {name}: {error}', file=sys.stderr)
                missed += 1
                continue
            print(text(found), flush=True)
            missed += not found['reached']
    return int(missed > 0)


if __name__ == '__main__':
    sys.exit(main())
