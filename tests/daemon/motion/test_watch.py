"""What telemetry says about motion that no order explains."""

from daemon.motion.watch import Watch
from drivers.interfaces import Telemetry
from drivers.settings import PositionerSettings


def look(time_s, b, to_b):
    return Telemetry(time_s, 0.0, b / 3, 50.0, b, 50.0, to_b)


def test_what_an_axis_makes_up_after_its_arrival_is_no_part_of_the_next_way():
    watch = Watch(PositionerSettings(position_unit="mm"))
    watch.rest(look(0, 280.0, 280.0))
    watch.expect(look(1, 280.0, 282.0))
    watch.arrived(look(2, 280.9, 282.0))
    for time_s, position in ((3, 281.5), (4, 282.1), (5, 282.1)):
        assert watch.update(look(time_s, position, 282.0)) is None
    watch.expect(look(6, 282.1, 10.0))
    assert watch.update(look(6.5, 282.1, 10.0)) is None
    assert watch.update(look(7, 281.0, 10.0)) is None
    assert "moves away" in watch.update(look(8, 284.0, 10.0)).text
