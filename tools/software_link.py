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
Two TAP devices joined by this process, which delays and loses packets as `tc netem` does.

    python -m tools.software_link DELAY JITTER LOSS DEVICE DEVICE

For kernels without netem. Times in s; every packet draws its own, so that packets overtake.
"""

from __future__ import annotations

import fcntl
import heapq
import os
import random
import select
import struct
import sys
import time

_TUNSETIFF = 0x400454CA
_IFF_TAP, _IFF_NO_PI = 0x0002, 0x1000
_LARGEST_FRAME = 65536
_LONGEST_WAIT = 1.0  # s


def open_tap(name: str) -> int:
    """Make a TAP device and return its file descriptor; it lives as long as that is open."""
    descriptor = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, _TUNSETIFF, struct.pack('16sH', name.encode(), _IFF_TAP | _IFF_NO_PI))
    return descriptor


class SoftwareLink:
    """Packets under way between two devices."""

    def __init__(self, ends: tuple[int, int], delay: float, jitter: float, loss: float) -> None:
        self._other = {ends[0]: ends[1], ends[1]: ends[0]}
        self._delay, self._jitter, self._loss = delay, jitter, loss
        self._under_way: list[tuple[float, int, int, bytes]] = []
        self._count = 0

    def serve(self) -> None:
        """Pass packets on, for ever."""
        while True:
            now = time.monotonic()
            while self._under_way and self._under_way[0][0] <= now:
                _, _, end, packet = heapq.heappop(self._under_way)
                self._write(end, packet)
            wait = self._under_way[0][0] - now if self._under_way else _LONGEST_WAIT
            for end in select.select(list(self._other), [], [], max(wait, 0.0))[0]:
                self._take(end)

    def _take(self, end: int) -> None:
        while True:
            try:
                packet = os.read(end, _LARGEST_FRAME)
            except OSError:  # none left, or the device is down
                return
            if random.random() < self._loss:
                continue
            due = time.monotonic() + random.uniform(
                self._delay - self._jitter, self._delay + self._jitter
            )
            self._count += 1
            heapq.heappush(self._under_way, (due, self._count, self._other[end], packet))

    def _write(self, end: int, packet: bytes) -> None:
        try:
            os.write(end, packet)
        except OSError:  # the device is down or its queue is full: as on any wire, it is lost
            return


def main() -> None:
    """Make the devices and serve them until the process is ended."""
    delay, jitter, loss = map(float, sys.argv[1:4])
    one, other = map(open_tap, sys.argv[4:6])
    SoftwareLink((one, other), delay, jitter, loss).serve()


if __name__ == '__main__':
    main()
