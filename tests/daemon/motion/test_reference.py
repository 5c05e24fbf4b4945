"""What is in doubt about the reference, in words."""

from daemon.base.files import StateFolder
from daemon.motion.reference import RESET, Doubts


def test_what_two_doubts_say_is_said_once():
    doubts = Doubts(StateFolder(None))
    met = "axis A met its end switch where its count was -318.56, not 0: home it again"
    doubts.doubt("count", f"{met}; the positioner has restarted")
    doubts.doubt("homing", f"homing failed ({met}), the reference is in doubt: home it")
    doubts.doubt("reset", RESET)
    assert doubts.reference == f"homing failed ({met}), the reference is in doubt: home it; {RESET}"
    assert len(doubts.texts) == 3
