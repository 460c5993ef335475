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
Two hosts on one machine: network namespaces joined by a link that may delay and lose.

Root, iproute2 and Linux are needed. A clean link is a veth pair. A bad one is a veth pair with
`tc netem` on both ends where the kernel has netem; elsewhere two TAP devices, between which a
process passes the packets on, late or not at all, as netem would.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
import os
import shutil
import subprocess
import sys
import time

from tools.priority import make_real_time

_NAMES = ('control', 'plants')
_NETWORK = '10.77.0'
_SETTLED = 5.0  # s for the link's process to make its devices


class NotPossible(Exception):
    """Raised where one machine cannot pretend to be two; says why."""


@dataclass(frozen=True)
class Link:
    """
    What happens to every packet, in either direction: delay [s], and the share that is lost.

    The delay is uniformly distributed, `jitter` s to either side, so that packets overtake.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0

    @property
    def clean(self) -> bool:
        """Whether packets are passed on at once and all."""
        return not (self.delay or self.jitter or self.loss)

    def __str__(self) -> str:
        if self.clean:
            return 'clean'
        return (
            f'{1e3 * self.delay:g} +- {1e3 * self.jitter:g} ms either way, '
            f'{100 * self.loss:g} % lost'
        )


@dataclass(frozen=True)
class Host:
    """A network namespace; `within`, put before a command, runs it there."""

    namespace: str

    @property
    def within(self) -> tuple[str, ...]:
        """Return the words that run a command on this host."""
        return ('ip', 'netns', 'exec', self.namespace)


@dataclass(frozen=True)
class Hosts:
    """The two hosts, and what makes the link between them."""

    control: Host
    plants: Host
    made_by: str


def why_not() -> str:
    """Return why this machine cannot make two hosts, '' if it can."""
    if not sys.platform.startswith('linux'):
        return 'network namespaces are a matter of Linux'
    if shutil.which('ip') is None or shutil.which('tc') is None:
        return 'iproute2 (ip, tc) is needed'
    if os.geteuid() != 0:
        return 'root is needed to make network namespaces'
    name = f'tdm_try_{os.getpid()}'
    tried = subprocess.run(['ip', 'netns', 'add', name], capture_output=True, text=True)
    if tried.returncode:
        return f'network namespaces cannot be made here: {tried.stderr.strip()}'
    subprocess.run(['ip', 'netns', 'delete', name], check=True)
    return ''


def environment() -> dict[str, str]:
    """
    Return the variables of ROS processes on such hosts.

    Packets are to go over the link: without shared memory, which both hosts have in common.
    """
    return {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET', 'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}


@contextmanager
def two_hosts(link: Link, real_time: int = 0) -> Iterator[Hosts]:
    """
    Yield two hosts joined by `link`; everything is removed at last.

    `real_time` is for the process that makes the link, where there is one.

    Raises
    ------
    NotPossible
        If this machine cannot make them.

    """
    reason = why_not()
    if reason:
        raise NotPossible(reason)
    control, plants = (Host(f'tdm_{name}_{os.getpid()}') for name in _NAMES)
    with ExitStack() as clean_up:
        for host in (control, plants):
            _run('ip', 'netns', 'add', host.namespace)
            clean_up.callback(_run, 'ip', 'netns', 'delete', host.namespace)
        made_by = _join((control, plants), link, real_time, clean_up)
        for number, host in enumerate((control, plants), start=1):
            within = ('ip', '-n', host.namespace)
            _run(*within, 'address', 'add', f'{_NETWORK}.{number}/24', 'dev', _device(number))
            _run(*within, 'link', 'set', 'lo', 'up')
            _run(*within, 'link', 'set', _device(number), 'up')
            # Discovery is by multicast, which needs a route.
            _run(*within, 'route', 'add', '224.0.0.0/4', 'dev', _device(number))
        yield Hosts(control, plants, made_by)


def _device(number: int) -> str:
    return f'tdm_link{number}'


def _join(hosts: tuple[Host, Host], link: Link, real_time: int, clean_up: ExitStack) -> str:
    if link.clean or _has_netem():
        one, other = (host.namespace for host in hosts)
        _run('ip', 'link', 'add', _device(1), 'netns', one, 'type', 'veth',
             'peer', 'name', _device(2), 'netns', other)  # fmt: skip
        if link.clean:
            return 'a veth pair'
        for number, host in enumerate(hosts, start=1):
            _run('tc', '-n', host.namespace, *_netem(link, _device(number)))
        return 'a veth pair with netem'
    _software_link(hosts, link, real_time, clean_up)
    return 'TAP devices and a process that passes packets on (this kernel has no netem)'


def _netem(link: Link, device: str) -> tuple[str, ...]:
    return (
        *('qdisc', 'add', 'dev', device, 'root', 'netem', 'limit', '10000'),
        *('delay', f'{1e3 * link.delay:g}ms', f'{1e3 * link.jitter:g}ms'),
        *('loss', f'{100 * link.loss:g}%'),
    )


def _has_netem() -> bool:
    """Whether the kernel can do it, tried in a namespace of its own."""
    name = f'tdm_try_{os.getpid()}'
    _run('ip', 'netns', 'add', name)
    try:
        tried = subprocess.run(['tc', '-n', name, *_netem(Link(0.001), 'lo')], capture_output=True)
        return tried.returncode == 0
    finally:
        _run('ip', 'netns', 'delete', name)


def _software_link(
    hosts: tuple[Host, Host], link: Link, real_time: int, clean_up: ExitStack
) -> None:
    process = subprocess.Popen(
        [
            *(sys.executable, '-m', 'tools.software_link'),
            *(str(link.delay), str(link.jitter), str(link.loss)),
            *(f'tdm{os.getpid()}_{number}' for number in (1, 2)),
        ],
        start_new_session=True,
    )
    clean_up.callback(process.wait)
    clean_up.callback(process.terminate)
    make_real_time({'link to the plants': process.pid}, real_time)
    for number, host in enumerate(hosts, start=1):
        made = f'tdm{os.getpid()}_{number}'
        end = time.monotonic() + _SETTLED
        while subprocess.run(['ip', 'link', 'show', made], capture_output=True).returncode:
            if process.poll() is not None or time.monotonic() > end:
                raise NotPossible('TAP devices cannot be made here (/dev/net/tun)')
            time.sleep(0.02)
        _run('ip', 'link', 'set', made, 'netns', host.namespace, 'name', _device(number))


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise NotPossible(f'{" ".join(command)}: {done.stderr.strip()}')
