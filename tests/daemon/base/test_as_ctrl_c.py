"""SIGTERM and a lost connection count as Ctrl-C, once."""

import signal

import pytest

from daemon.base.process import signals_as_ctrl_c


def test_sigterm_sent_twice_raises_keyboard_interrupt_once_and_the_handler_is_restored():
    before = signal.getsignal(signal.SIGTERM)
    with signals_as_ctrl_c():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before
