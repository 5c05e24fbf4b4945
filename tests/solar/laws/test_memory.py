"""What the law `optimal` expects of the sky, compared with a calculation reading by reading."""

import numpy as np
import pytest

from solar.laws.light import light_from_faces
from solar.laws.memory import LightMemory, OptimalSettings

SUN = np.array([0.5, 0.5, np.sqrt(0.5)])
CLEAR, CLOUDY, HAZY = (450.0, 450.0, 60.0, 660.0), (70.0, 75.0, 65.0, 140.0), (300.0, 310.0, 80.0, 500.0)
DARK = (np.nan, 400.0, np.nan, 600.0)
SETTINGS = OptimalSettings(forget_after_s=600.0)


def light(faces):
    return np.array(light_from_faces(faces, SUN, 0.2))


def heard(*readings, settings=SETTINGS):
    memory = LightMemory(settings)
    for faces, elapsed_s in readings:
        memory.observe(faces, SUN, elapsed_s)
    return memory


class Beside:
    """The same memory, written as on paper."""

    def __init__(self, first):
        self.quick = self.slow = light(first)
        self.deviation = 0.0

    def then(self, faces, elapsed_s):
        new = light(faces)
        # The quick memory of the beam, that of the two parts of the diffuse light, and the slow memory of all three.
        half_lives_s = np.array([100.0, 400.0, 400.0]), 720.0
        quick_share, slow_share = (1.0 - 0.5 ** (elapsed_s / half_life_s) for half_life_s in half_lives_s)
        self.quick = self.quick + quick_share * (new - self.quick)
        self.slow = self.slow + slow_share * (new - self.slow)
        self.deviation += slow_share * (abs(self.quick[0] - self.slow[0]) - self.deviation)
        return self

    def expects(self, thrift=1.0):
        unrest = self.deviation / (self.slow[0] + 0.1 * self.slow[1] + 10.0)
        share = min(0.3 * np.sqrt(thrift) * unrest, 0.8)
        return unrest, (1.0 - share) * self.quick + share * self.slow


def test_the_light_is_unknown_before_the_first_reading_and_then_exactly_that_of_the_first_reading():
    assert not heard().expect().known
    expected = heard((CLEAR, 60.0)).expect()
    assert expected.known
    assert expected.beam_variability == 0.0
    np.testing.assert_allclose(np.array(expected.light), light(CLEAR))


@pytest.mark.parametrize("thrift", [0.1, 1.0, 10.0, 100.0])
def test_the_light_expected_of_a_varying_sky_lies_between_its_quick_and_its_slow_mean(thrift):
    memory = heard((CLEAR, 60.0), (CLOUDY, 240.0), (HAZY, 60.0), (CLOUDY, 240.0))
    unrest, expected = Beside(CLEAR).then(CLOUDY, 240.0).then(HAZY, 60.0).then(CLOUDY, 240.0).expects(thrift)
    says = memory.expect(thrift)
    assert 0.3 * 10.0 * unrest > 0.8, "the thriftiest is at the bound"
    assert says.beam_variability == pytest.approx(unrest)
    np.testing.assert_allclose(np.array(says.light), expected)
    assert memory.expect().light == pytest.approx(memory.expect(1.0).light)


def test_a_reading_with_too_few_faces_leaves_the_expected_light_and_the_unrest_unchanged():
    before, after = heard((CLEAR, 60.0), (HAZY, 60.0)), heard((CLEAR, 60.0), (HAZY, 60.0), (DARK, 60.0))
    np.testing.assert_array_equal(np.array(after.expect().light), np.array(before.expect().light))
    assert after.expect().beam_variability == before.expect().beam_variability > 0.0
    assert np.isnan(after.light.beam)
    assert before.light.beam == pytest.approx(light(HAZY)[0])


@pytest.mark.parametrize(("gap_s", "known"), [(600.0, True), (601.0, False)])
def test_the_expected_light_is_forgotten_after_more_than_600_s_without_a_usable_reading(gap_s, known):
    assert heard((CLEAR, 60.0), (DARK, gap_s)).expect().known == known
    assert heard((CLEAR, 60.0), (DARK, 300.0), (DARK, gap_s - 300.0)).expect().known == known


@pytest.mark.parametrize(("gap_s", "forgotten"), [(540.0, False), (541.0, True)])
def test_after_a_gap_longer_than_600_s_the_memory_starts_anew_with_the_next_reading(gap_s, forgotten):
    memory = heard((CLEAR, 60.0), (CLOUDY, 60.0), (DARK, gap_s), (HAZY, 60.0))
    if forgotten:
        np.testing.assert_allclose(np.array(memory.expect().light), light(HAZY))
    else:
        _, expected = Beside(CLEAR).then(CLOUDY, 60.0).then(HAZY, 60.0).expects()
        np.testing.assert_allclose(np.array(memory.expect().light), expected)
    # A good reading ends the gap.
    memory.observe(DARK, SUN, 600.0)
    assert memory.expect().known


def test_readings_observed_together_give_the_same_light_as_one_after_the_other():
    readings = ((CLEAR, 60.0), (CLOUDY, 30.0), (HAZY, 120.0))
    together = LightMemory(SETTINGS)
    together.observe([faces for faces, _ in readings], [SUN] * 3, [seconds for _, seconds in readings])
    alone = heard(*readings)
    np.testing.assert_allclose(np.array(together.expect().light), np.array(alone.expect().light))
    np.testing.assert_allclose(np.array(together.light), np.array(alone.light))


def test_a_memory_for_two_trackers_expects_for_each_the_light_of_its_own_readings():
    together = LightMemory(SETTINGS, (2,))
    together.observe([CLEAR, CLEAR], [SUN, SUN], 60.0)
    together.observe([HAZY, DARK], [SUN, SUN], [60.0, 30.0])
    together.observe([CLOUDY, CLOUDY], [SUN, SUN], [90.0, 30.0])
    alone = heard((CLEAR, 60.0), (HAZY, 60.0), (CLOUDY, 90.0)), heard((CLEAR, 60.0), (DARK, 30.0), (CLOUDY, 30.0))
    found = np.array(together.expect().light)
    for place, memory in enumerate(alone):
        np.testing.assert_allclose(found[:, place], np.array(memory.expect().light))


def test_a_reading_with_the_sun_below_the_horizon_is_not_used():
    memory = LightMemory(SETTINGS)
    memory.observe(CLOUDY, SUN * [1, 1, -1], 60.0)
    assert not memory.expect().known


def test_readings_observed_by_a_copied_memory_leave_the_original_unchanged():
    memory = heard((CLEAR, 60.0))
    memory.copied().observe(CLOUDY, SUN, 600.0)
    np.testing.assert_allclose(np.array(memory.expect().light), light(CLEAR))


def test_a_thrift_from_0_1_to_100_is_accepted_and_any_other_is_refused():
    for thrift in (0.1, 100.0):
        assert OptimalSettings(thrift=thrift).thrift == thrift
    for thrift in (0.09, 101.0, np.nan):
        with pytest.raises(ValueError, match=r"not in 0\.1\.\.100"):
            OptimalSettings(thrift=thrift)
