# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import signal

import pytest
from tdm_planner.interruption import Interrupted, interruptible, uninterrupted


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_interrupts_and_the_second_does_not_disturb(number):
    before = signal.getsignal(number)
    done = []

    def work():
        with interruptible():
            try:
                signal.raise_signal(number)
            finally:
                signal.raise_signal(signal.SIGINT)
                signal.raise_signal(signal.SIGTERM)
                done.append('cleaned up')

    with pytest.raises(Interrupted) as found:
        work()
    assert done
    assert found.value.code == 128 + number
    assert signal.getsignal(number) is before


def test_a_block_is_done_whole():
    done = []

    def work():
        with interruptible():
            with uninterrupted():
                signal.raise_signal(signal.SIGTERM)
                done.append(1)
            done.append(2)

    with pytest.raises(Interrupted) as found:
        work()
    assert done == [1]
    assert found.value.code == 143


def test_without_a_signal_nothing_happens():
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with interruptible(), uninterrupted():
        pass
    assert handlers == [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
