# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
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
