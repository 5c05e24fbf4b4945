"""How channels are named."""

from drivers.cube.scanning.dialects import channel_list, slot_of


def test_a_channel_lies_in_the_slot_of_its_hundreds_or_in_the_only_one():
    assert [slot_of(channel) for channel in (1, 20, 101, 199, 200, 201, 320)] == [1, 1, 1, 1, 2, 2, 3]


def test_a_list_of_channels():
    assert channel_list([101, 204]) == "(@101,204)"
