"""Why the reference is in doubt, in words."""

import asyncio
from random import Random

from daemon.base.clock import LoopClock
from daemon.base.process import SystemdNotifier
from daemon.base.records import Bus
from daemon.base.state import StateFolder
from daemon.config.settings import Settings
from daemon.motion.doubts import NOT_FINISHED, RESET, Doubts, fault_text, kept_doubts
from daemon.rigs.real import build_positioner
from daemon.service.rig import Rig, Role, TrackerInstruments
from daemon.service.service import Service
from drivers.interfaces import Telemetry
from tests.support.addresses import free_port


def test_a_sentence_that_two_doubts_have_in_common_is_said_once():
    doubts = Doubts(StateFolder(None))
    met = "axis A met its end switch where its count was -318.56, not 0: home it again"
    doubts.add_doubt("count", f"{met}; the positioner has restarted")
    doubts.add_doubt("homing", f"homing failed ({met}), the reference is in doubt: home it")
    doubts.add_doubt("reset", RESET)
    assert doubts.reference == f"homing failed ({met}), the reference is in doubt: home it; {RESET}"
    assert len(doubts.texts) == 3


def look(*faults, **more):
    return Telemetry(1.0, 0.0, 90.0, 50.0, 280.0, 50.0, 280.0, faults=faults, **more)


def test_a_fault_that_vanishes_is_a_doubt_unless_the_service_has_cleared_it():
    doubts = Doubts(StateFolder(None))
    doubts.see(look("a_cable", "b_cable"), clearing=False)
    doubts.see(look("b_cable"), clearing=False)
    text = "a_cable cleared by itself, the reference may be lost: home it"
    assert (doubts.reference, [*doubts.vanished_faults.values()], doubts.texts) == (text, [text], (text,))
    doubts.see(look(), clearing=True)
    doubts.note_faults_cleared()
    doubts.see(look(), clearing=False)
    assert doubts.texts == (text,)


def test_kept_doubts_are_read_together_with_the_faults_that_have_vanished_since(tmp_path):
    folder = StateFolder(tmp_path)
    assert kept_doubts(folder, look()) == ()
    doubts = Doubts(folder)
    doubts.add_incident("motion", "A moved without an order")
    doubts.see(look("a_cable", "b_cable", was_reset=True), clearing=False)
    doubts.homing_begins()
    noted = ("A moved without an order", RESET)
    assert kept_doubts(folder) == (*noted, NOT_FINISHED)
    gone = "a_cable cleared by itself, the reference may be lost: compare the angles with where the tracker points"
    assert kept_doubts(folder, look("b_cable")) == (*noted, gone, NOT_FINISHED)


def test_a_restart_and_a_doubt_about_the_count_that_the_unit_reports_are_doubts_of_the_reference():
    doubts = Doubts(StateFolder(None))
    assert doubts.reference is None
    doubts.see(look(was_reset=True, reference_doubt="the count has jumped"), clearing=True)
    assert doubts.texts == (RESET, "the count has jumped")
    assert not doubts.vanished_faults


def test_only_doubts_that_were_shown_are_forgiven():
    doubts = Doubts(StateFolder(None))
    doubts.add_doubt("count", "the count has jumped")
    doubts.add_incident("motion", "B moved")
    doubts.add_incident("motion", "B moved again")
    doubts.add_incident("deaf", "it does not obey")
    assert doubts.incident == "B moved; it does not obey"
    assert (doubts.incident_of("motion"), doubts.incident_of("other")) == ("B moved", None)
    doubts.acknowledge(("B moved", fault_text("a_cable")), look("a_cable", "b_cable"))
    unseen = "b_cable was cleared before anybody had seen it: home it"
    assert doubts.texts == ("it does not obey", "the count has jumped", unseen)
    doubts.see(look(), clearing=False)
    assert doubts.texts == ("it does not obey", "the count has jumped", unseen)


def test_doubts_incidents_and_vanished_faults_outlive_the_service(tmp_path):
    folder = StateFolder(tmp_path)
    doubts = Doubts(folder)
    doubts.add_doubt("count", "the count has jumped")
    doubts.add_incident("motion", "B moved")
    doubts.see(look("a_cable"), clearing=False)
    after = Doubts(folder)
    assert after.texts == ("B moved", "the count has jumped")
    after.see(look(), clearing=False)
    assert after.vanished_faults


def test_a_reference_run_during_which_the_service_ended_counts_as_not_finished(tmp_path):
    folder = StateFolder(tmp_path)
    doubts = Doubts(folder)
    doubts.homing_begins()
    assert doubts.reference is None
    assert Doubts(folder).reference == NOT_FINISHED
    doubts.homing_ends(None)
    assert Doubts(folder).reference is None
    doubts.homing_ends("axis A was not found")
    assert Doubts(folder).reference == "axis A was not found"
    doubts.homing_begins()
    doubts.add_incident("motion", "B moved")
    doubts.clear_doubts()
    assert Doubts(folder).texts == ("B moved",)


def test_the_doubt_of_a_drive_without_a_reference_run_asks_to_compare_angles_and_not_to_home(tmp_path, caplog):
    (tmp_path / "motion.json").write_text("{")
    own = {"driver": "rotctld", "server": f"127.0.0.1:{free_port()}"}
    whole = {"instruments": {"positioner": own}, "store": {"directory": tmp_path}, "bridge": {"listen": "127.0.0.1:0"}}
    settings = Settings.model_validate(whole)

    async def scenario():
        clock = LoopClock(asyncio.get_running_loop().time, 1.7e9)
        rig = Rig(None, (TrackerInstruments(build_positioner(settings, clock)),), None, simulated=False)
        service = Service(
            settings, Role.TRACKER, rig, clock, Random(1), Bus(), bytes(range(32)), SystemdNotifier({}, 0)
        )
        return service.trackers[0].motion.doubt

    doubt = asyncio.run(scenario())
    assert doubt.endswith(
        "in doubt before the restart: compare the angles with where the tracker points, then clear it"
    )
    assert "home" not in doubt + caplog.text
