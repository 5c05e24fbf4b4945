"""How channels are named."""

from drivers.cube.scanning.dialects import channel_list, slot_of


def test_the_hundreds_of_a_channel_number_give_its_slot_and_below_100_it_is_slot_1():
    assert [slot_of(channel) for channel in (1, 20, 101, 199, 200, 201, 320)] == [1, 1, 1, 1, 2, 2, 3]


def test_channels_are_written_as_a_scpi_channel_list():
    assert channel_list([101, 204]) == "(@101,204)"
