"""Several trackers in one file: what holds for each, and what is said about a table that is wrong."""

import textwrap

import pytest

from daemon.config.file import ConfigError, override
from daemon.config.settings import Settings

TWO = """
    [limits]
    a_max_deg = 45
    [law]
    name = "flat"
    [[tracker]]
    name = "east"
    [tracker.limits]
    a_max_deg = 40
    [tracker.positioner.a_axis]
    low_deg = -51.0
    [[tracker]]
    name = "west"
    [tracker.site]
    longitude_deg = 2.21
    [tracker.law]
    driver = "chronometric"
    """


def problems(read, text):
    with pytest.raises(ConfigError) as caught:
        read(text)
    return list(caught.value.problems)


def test_a_file_without_tables_is_one_tracker_with_the_settings_of_the_file(read):
    settings = read("[store]\ndirectory = 'records'\n")
    assert settings.trackers == (("tracker", settings),)
    assert read("[mqtt]\nname = 'roof'\n").trackers[0].name == "roof"


def test_each_tracker_table_overrides_the_sections_of_the_file(read):
    settings = read(TWO)
    (east, of_east), (west, of_west) = settings.trackers
    assert (east, west) == ("east", "west")
    assert (of_east.limits.a_max_deg, of_west.limits.a_max_deg) == (40.0, 45.0)
    assert (of_east.law.driver, of_west.law.driver) == ("flat", "chronometric")
    assert (of_east.site.longitude_deg, of_west.site.longitude_deg) == (settings.site.longitude_deg, 2.21)
    low_deg = [own.instruments.positioner.a_axis.low_deg for own in (of_east, of_west)]
    assert low_deg == [-51.0, -52.0]
    assert of_east.instruments.positioner.a_axis.apex_deg == of_west.instruments.positioner.a_axis.apex_deg


def test_each_tracker_has_its_own_store_folder_mqtt_name_and_client_id(read, tmp_path):
    settings = read(f"[store]\ndirectory = 'records'\n[mqtt]\nclient_id = 'roof'\n{textwrap.dedent(TWO)}")
    found = [(own.store.directory, own.mqtt.name, own.mqtt.client_id) for _, own in settings.trackers]
    folder = (tmp_path / "records").resolve()
    assert found == [(folder / "east", "east", "roof-east"), (folder / "west", "west", "roof-west")]


def test_a_setting_on_the_command_line_applies_to_all_trackers(read):
    changed = override(read(TWO), {"law": {"driver": "mu-prime"}})
    assert [own.law.driver for _, own in changed.trackers] == ["mu-prime", "mu-prime"]
    assert changed.trackers[0].settings.limits.a_max_deg == 40.0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "[[tracker]]\nname = 'east'\n[tracker.limits]\na_max_deg = 60\n",
            "tracker[east].limits.a_max_deg = 60: must be a number from -50 to 50 deg",
        ),
        (
            "[[tracker]]\nname = 'east'\n[tracker.limits]\na_maximum_deg = 40\n",
            "tracker[east].limits.a_maximum_deg = 40: there is no such key; did you mean limits.a_max_deg?",
        ),
        (
            "[[tracker]]\nname = 'east'\n[tracker.limit]\na_max_deg = 40\n",
            "tracker[east].limit: a tracker has no such section; did you mean limits?",
        ),
        (
            "[[tracker]]\nname = 'east'\n[tracker.cube]\nname = 'other'\n",
            "tracker[east].cube: a tracker has no such section; the trackers of a process have one cube and one bridge",
        ),
        (
            "[[tracker]]\nname = 'east'\n[tracker.positioner]\nport = '/dev/ttyACM0'\n",
            'tracker[east].positioner.port = "/dev/ttyACM0": must be a port whose name outlives a replug',
        ),
        (
            "[safety]\nnight_a_deg = 20\n[[tracker]]\nname = 'east'\n[tracker.limits]\na_max_deg = 10\n",
            "tracker[east].safety.night_a_deg = 20.0: lies outside limits.a_min_deg and limits.a_max_deg",
        ),
        (
            "[[tracker]]\nname = 'a/b'\n",
            'tracker[0].name = "a/b": every tracker has a name, 1 to 32 letters, digits, dashes or underscores',
        ),
        ("[[tracker]]\n", "tracker[0].name: every tracker has a name"),
        (
            "[[tracker]]\nname = 'east'\n[[tracker]]\nname = 'East'\n",
            'tracker[1].name = "East": is the name of another tracker already',
        ),
        ("[tracker]\nname = 'east'\n", "tracker: a tracker is a table of a list; write [[tracker]]"),
        ("[[trackers]]\nname = 'east'\n", "trackers: there is no such key; did you mean [[tracker]]"),
        ("[[tracker]]\nname = 'east'\nlimits = 3\n", "tracker[east].limits = 3: must be a section of its own"),
        (
            "[site]\nlatitude_deg = 48.7\n[[tracker]]\nname = 'east'\n[tracker.site]\nlatitude_deg = -33.0\n",
            "tracker[east].site.latitude_deg = -33.0: is on the other side of the equator than the cube",
        ),
        (
            """
            [instruments]
            kind = 'real'
            [instruments.positioner]
            port = '/dev/roof'
            [[tracker]]
            name = 'east'
            [[tracker]]
            name = 'west'
            """,
            'tracker[west].positioner.port = "/dev/roof": is that of the tracker east already',
        ),
        (
            """
            [instruments]
            kind = "real"
            [[tracker]]
            name = "east"
            [tracker.positioner]
            port = "/dev/roof"
            [[tracker]]
            name = "west"
            [tracker.load]
            driver = "agilent6063b"
            resource = "ASRL/dev/roof::INSTR"
            """,
            'tracker[west].load.resource = "ASRL/dev/roof::INSTR": is the positioner.port of the tracker east already',
        ),
    ],
)
def test_a_mistake_in_a_tracker_table_is_reported_once_with_its_place_and_remedy(read, text, expected):
    (problem,) = problems(read, text)
    assert problem.startswith(expected)


def test_a_mistake_in_a_section_of_the_file_is_not_reported_again_for_each_tracker(read):
    found = problems(read, "[limits]\na_max_deg = 60\n[[tracker]]\nname = 'east'\n[[tracker]]\nname = 'west'\n")
    assert found == ["limits.a_max_deg = 60: must be a number from -50 to 50 deg"]


def test_settings_made_in_the_program_obey_the_same_rules():
    with pytest.raises(ValueError, match=r"is there twice"):
        Settings.model_validate({"tracker": [{"name": "east"}, {"name": "EAST"}]})
    with pytest.raises(ValueError, match="other side of the equator"):
        Settings.model_validate({"tracker": [{"name": "east", "site": {"latitude_deg": -33.0}}]})
    with pytest.raises(ValueError, match="night_a_deg"):
        Settings.model_validate({"tracker": [{"name": "east", "limits": {"a_max_deg": -10.0}}]})


LOADS = """
    [load]
    driver = "agilent6063b"
    resource = "GPIB0::5::INSTR"
    [[tracker]]
    name = "east"
    [tracker.load]
    prologix_port = "/dev/adapter-a"
    [[tracker]]
    name = "west"
    [tracker.load]
    prologix_port = "/dev/adapter-{}"
    """


def test_two_loads_with_the_same_address_need_an_adapter_each(read):
    assert len(read(LOADS.format("b")).trackers) == 2
    (problem,) = problems(read, LOADS.format("a"))
    expected = 'tracker[west].load.prologix_port = "/dev/adapter-a": is that of the tracker east already'
    assert problem.startswith(expected)
