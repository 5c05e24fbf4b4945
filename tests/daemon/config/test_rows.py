"""The group of trackers in the file: how it is read, and what is said where it cannot be one."""

import pytest

from daemon.config.file import ConfigError
from daemon.config.settings import Settings

GOOD = """
    [rows]
    east_m = [0, 5, 10]
    north_m = [0.0, 0.0, 0.5]
    module_width_m = 2.0
    module_height_m = 1.2
    """


def test_without_positions_there_is_no_group(read):
    assert Settings().rows.group(55.0) is None
    assert read("[rows]\nmodule_width_m = 2.0\nmodule_height_m = 2.0\n").rows.group(55.0) is None


def test_all_trackers_of_a_group_share_one_layout(read):
    settings = read(GOOD + '    bypass_groups = 6\n    [[tracker]]\n    name = "a"\n    [[tracker]]\n    name = "b"\n')
    groups = [own.rows.group(own.site.latitude_deg) for _, own in settings.trackers]
    assert groups[0] is groups[1]
    assert (groups[0].count, groups[0].size_m, groups[0].bypass_groups) == (3, (2.0, 1.2), 6)


def test_two_groups_in_one_process_are_configured_in_the_tables_of_their_trackers(read):
    one_by_one = GOOD + '    [[tracker]]\n    name = "a"\n    [[tracker]]\n    name = "b"\n    [tracker.rows]\n'
    of_a, of_b = (own for _, own in read(one_by_one + "    east_m = [0, 9, 20]\n").trackers)
    assert of_a.rows.east_m == (0.0, 5.0, 10.0)
    assert of_b.rows.east_m == (0.0, 9.0, 20.0)


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("[0, 5, 10]", "[0, 5]", "rows.north_m = [0.0, 0.0, 0.5]: names 3 trackers and rows.east_m names 2; both must"),
        ("[0, 5, 10]", "[0, 5, 7]", "rows.east_m = [0.0, 5.0, 7.0]: puts the trackers 2 and 3 2.06 m apart, where"),
        ("[0, 5, 10]", '[0, "five", 10]', 'rows.east_m[1] = "five": must be a number from -100000 to 100000 m'),
        ("[0, 5, 10]", "[0, nan, 10]", "rows.east_m[1] = nan: must be a number from -100000 to 100000 m"),
        ("= 2.0", "= -2.0", "rows.module_width_m = -2.0: must be a number above 0 and up to 100 m"),
        ("module_width_m = 2.0", "", "rows.east_m = [0.0, 5.0, 10.0]: needs rows.module_width_m, the size of the"),
        (
            "module_width_m",
            "up_m = [0]\n    module_width_m",
            "rows.up_m = [0.0]: names 1 tracker and rows.east_m names 3;",
        ),
    ],
)
def test_a_mistake_in_the_positions_or_sizes_of_a_group_is_refused_in_one_sentence(read, before, after, told):
    with pytest.raises(ConfigError) as caught:
        read(GOOD.replace(before, after))
    (sentence,) = caught.value.problems
    assert sentence.startswith(told)


def test_a_group_of_one_tracker_is_refused(read):
    with pytest.raises(ConfigError, match="names one tracker; a group has two or more"):
        read(GOOD.replace("[0, 5, 10]", "[0]").replace("[0.0, 0.0, 0.5]", "[0]"))
