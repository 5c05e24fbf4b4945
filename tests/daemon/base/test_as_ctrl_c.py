"""SIGTERM and a lost connection count as Ctrl-C, once."""

import signal

import pytest

from daemon.base.process import as_ctrl_c


def test_a_signal_that_comes_twice_interrupts_once_and_not_what_is_put_in_order():
    before = signal.getsignal(signal.SIGTERM)
    with as_ctrl_c():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before
