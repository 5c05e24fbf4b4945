"""The bus hands each record to whom it concerns, and to nobody else."""

from daemon.base.records import Bus, Event, FaceReading, Quality, Scan


def event(tracker):
    return Event(1.0, 1.0, "test", f"of {tracker or 'nobody'}", tracker=tracker)


def test_a_subscriber_of_one_tracker_gets_its_records_and_common_ones_and_others_get_all():
    bus, heard = Bus(), {"all": [], "east": [], "west": []}
    bus.subscribe(heard["all"].append)
    bus.subscribe(heard["east"].append, "east")
    bus.subscribe(heard["west"].append, "west")
    face = FaceReading(500.0, Quality.OK, 1.0, 1.0)
    scan = Scan("cube", "session", 1, 1.0, 1.0, face, face, face, face)
    for record in (event("east"), scan, event("west"), event(""), event("north")):
        bus.publish(record)
    assert heard["all"] == [event("east"), scan, event("west"), event(""), event("north")]
    assert heard["east"] == [event("east"), scan, event("")]
    assert heard["west"] == [scan, event("west"), event("")]
