"""Weather of one kind after another."""

import numpy as np
import pytest

from sim_drivers.weather import GeneratedWeather, WeatherInParts
from solar.ephemeris import Site

SITE = Site(48.717607, 2.209002, 156.0)
NOON = 1665576000.0


def parts():
    return [(NOON - 7200, GeneratedWeather("clear", SITE, 1)), (NOON, GeneratedWeather("overcast", SITE, 1))]


def test_each_part_has_its_own_weather():
    both = WeatherInParts(parts())
    (_, clear), (_, overcast) = parts()
    before, after = NOON - 3600 + np.arange(10.0), NOON + 3600 + np.arange(10.0)
    assert both.at(before).dni_w_m2 == pytest.approx(clear.at(before).dni_w_m2)
    assert both.at(after).dhi_w_m2 == pytest.approx(overcast.at(after).dhi_w_m2)
    assert both.covers(before).all()


def test_one_part_of_the_weather_blends_into_the_next_within_four_minutes():
    dni = WeatherInParts(parts()).at(NOON + np.array([-121.0, 0.0, 121.0])).dni_w_m2
    assert dni[1] == pytest.approx(dni[0] / 2, rel=0.01)
    assert dni[2] == 0.0


@pytest.mark.parametrize("wrong", [[], parts()[::-1]])
def test_weather_without_parts_or_with_parts_out_of_order_is_refused(wrong):
    with pytest.raises(ValueError, match="part"):
        WeatherInParts(wrong)
