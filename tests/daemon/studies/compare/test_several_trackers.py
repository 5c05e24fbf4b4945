"""Measurements out of a store in which one run has several trackers."""

from dataclasses import replace

import numpy as np
import pytest

from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.base.records import CurveQuality, FaceReading, IvCurve, Pose, Quality, Scan
from daemon.store.store import Origin, Store
from daemon.studies.compare.stored import kept_curve, read_stores

NOON = 1665572400.0
FACE = FaceReading(400.0, Quality.OK, NOON, 0.0)
SCAN = Scan("cube", "a", 0, NOON, 0.0, FACE, FACE, FACE, FACE)
POINTS = "AAAAAAAAgD8AAABAAAAAAA=="
CURVE = IvCurve(
    time_utc_s=NOON + 1,
    time_monotonic_s=1.0,
    duration_s=1.0,
    pmpp_w=100.0,
    pmpp_sigma_w=1.0,
    vmpp_v=30.0,
    impp_a=3.3,
    voc_v=38.0,
    isc_a=9.0,
    zenith_start_w_m2=400.0,
    zenith_end_w_m2=400.0,
    points=2,
    quality=CurveQuality.OK,
    why="",
    curve=POINTS,
    tracker="east",
)
POSE = Pose(NOON, 0.0, 10.0, 60.0, moving=False, tracker="east")


def kept(folder, tracker, quality=CurveQuality.OK):
    """Keep the records of two trackers in a run, which bears a tracker's name only if it has just one."""
    origin = Origin(
        started_utc_s=NOON,
        role="both",
        version="0",
        simulated=True,
        site="x",
        latitude_deg=48.7,
        longitude_deg=2.2,
        altitude_m=156.0,
        tracker=tracker,
    )
    store = Store(folder, 60.0, 400, origin, SystemClock(), print)
    for record in (
        SCAN,
        POSE,
        replace(POSE, a_deg=-20.0, tracker="west"),
        replace(CURVE, quality=quality),
        replace(CURVE, pmpp_w=90.0, quality=quality, tracker="west"),
    ):
        store.keep(record)
    store.close()
    return folder


def measured(*stores):
    frame, _ = read_stores(stores)
    return sorted(zip(frame["tracker"], frame["a_deg"], frame["pmpp_w"], strict=True))


def test_each_tracker_of_a_run_has_its_own_curves_and_poses(tmp_path):
    folder = kept(tmp_path, "")
    assert measured((None, folder)) == [("east", 10.0, 100.0), ("west", -20.0, 90.0)]


def test_a_name_chooses_the_tracker_out_of_a_run_of_several(tmp_path):
    folder = kept(tmp_path, "")
    assert measured(("west", folder)) == [("west", -20.0, 90.0)]
    assert kept_curve([("west", folder)], "west").time_utc_s == NOON + 1
    assert np.array_equal(kept_curve([(None, folder)], "west").voltage_v, [0.0, 1.0])
    assert kept_curve([(None, folder)], "north") is None


@pytest.mark.parametrize(
    ("name", "quality", "why"),
    [
        ("T-Cube", CurveQuality.OK, "holds I-V curves of 'east', 'west' and none of 'T-Cube'"),
        ("west", CurveQuality.CLOCK, "holds I-V curves of 'east', 'west', but none of quality 'ok'"),
        (None, CurveQuality.DARK, "holds I-V curves of 'east', 'west', but none of quality 'ok'"),
    ],
)
def test_a_store_without_usable_curves_is_refused_with_the_trackers_whose_curves_it_holds(tmp_path, name, quality, why):
    folder = kept(tmp_path, "", quality)
    with pytest.raises(UserError) as refused:
        read_stores([(name, folder)])
    assert why in str(refused.value)
