"""Half an hour of four faces that contradict each other, without the watch around it."""

import numpy as np
import pytest

from daemon.cube.contradictions import MINUTES, Contradictions
from solar.faces.changes import change_misfits
from solar.faces.contradiction import misfits
from solar.faces.plausible import Doubt

NONE, DEAD, OVER, ODD, SWAPPED, TORN = (
    Doubt.NONE,
    Doubt.DEAD,
    Doubt.TOO_BRIGHT,
    Doubt.CONTRADICTED,
    Doubt.SWAPPED,
    Doubt.INCONSISTENT,
)
FROZEN = Doubt.FROZEN
SOUND = [NONE] * 4


def half_hour(order=(0, 1, 2, 3), share=(1.0, 1.0, 1.0, 1.0), minutes=MINUTES, beam_w_m2=700.0):
    """Faces [W/m2] under a beam, a uniform sky of 140 and a ground of 20 %; sun in the south-east."""
    azimuth, elevation = np.radians(np.linspace(130.0, 138.0, minutes)), np.radians(45.0)
    sun = np.stack(
        [
            -np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.full(minutes, np.sin(elevation)),
        ],
        axis=-1,
    )
    normals = np.array([[0.0, 1, 0], [1.0, 0, 0], [0.0, -1, 0], [0.0, 0, 1]])
    beam = np.broadcast_to(beam_w_m2, minutes)[:, None]
    ground = 0.2 * (beam * sun[:, 2:] + 140.0)
    faces = beam * np.maximum(sun @ normals.T, 0.0) + 70.0 * (1 + normals[:, 2]) + 0.5 * ground * (1 - normals[:, 2])
    return faces[:, list(order)] * share, sun


def after(contradictions, looks, whys=SOUND, **light):
    """Look every minute; return what is found at each."""
    return [contradictions.find_doubts(*half_hour(**light), whys) for _ in range(looks)]


def test_sound_faces_are_not_accused():
    contradictions = Contradictions()
    assert after(contradictions, 11) == [SOUND] * 11
    assert all(contradictions.agrees(face, [TORN, ODD, OVER, NONE]) for face in range(4))


PASSING_W_M2 = np.where(np.arange(MINUTES) % 7 < 3, 500.0, 700.0)


def test_a_face_that_does_not_change_with_the_light_is_found_where_the_readings_agree():
    faces, sun = half_hour(beam_w_m2=PASSING_W_M2)
    faces[:, 0] = faces[:, 0].mean()
    assert not misfits(faces, sun).is_contradictory
    assert Contradictions().find_doubts(faces, sun, SOUND) == [ODD, NONE, NONE, NONE]


def test_all_faces_are_doubted_when_readings_and_changes_accuse_different_faces():
    contradictions = Contradictions()
    faces, sun = half_hour(beam_w_m2=PASSING_W_M2)
    faces[:, 0] = faces[:, 0].mean()
    faces[:, 1] -= 300.0
    assert misfits(faces, sun).suspect_faces == (1,)
    assert change_misfits(faces, sun).suspect_faces == (0,)
    found = [contradictions.find_doubts(faces, sun, SOUND) for _ in range(6)]
    assert found == [SOUND] * 5 + [[TORN] * 4]


def test_with_less_than_half_an_hour_of_readings_no_face_is_accused_and_none_is_cleared():
    contradictions = Contradictions()
    shaded = {"share": (1.0, 0.3, 1.0, 1.0)}
    assert after(contradictions, 11, minutes=MINUTES - 1, **shaded) == [SOUND] * 11
    assert [contradictions.agrees(face, [ODD, TORN, SWAPPED, NONE]) for face in range(4)] == [False, False, False, True]


def test_a_face_in_a_shade_of_its_own_is_found_at_once_and_looked_at_again_after_five_minutes():
    contradictions = Contradictions()
    odd = [NONE, ODD, NONE, NONE]
    assert after(contradictions, 3, share=(1.0, 0.3, 1.0, 1.0)) == [odd] * 3
    assert not contradictions.agrees(1, odd)
    assert contradictions.agrees(0, odd)
    assert after(contradictions, 3, odd) == [odd, odd, SOUND]
    assert contradictions.agrees(1, odd)


@pytest.mark.parametrize(("face", "beam_w_m2"), [(2, 300.0), (3, 0.0)])
def test_a_face_is_not_cleared_under_light_in_which_twice_its_reading_would_agree_too(face, beam_w_m2):
    contradictions = Contradictions()
    odd = [ODD if place == face else NONE for place in range(4)]
    share = [0.55 if place == face else 1.0 for place in range(4)]
    after(contradictions, 1, odd, share=share, beam_w_m2=beam_w_m2)
    assert not contradictions.agrees(face, odd)
    assert contradictions.agrees(face, [TORN] * 4)
    after(contradictions, 5, odd)
    assert contradictions.agrees(face, odd) == (face == 3), "with the sun behind it the west face could read anything"


def test_two_swapped_faces_are_both_found_and_are_cleared_only_by_readings_in_order():
    contradictions = Contradictions()
    swapped = [NONE, NONE, SWAPPED, SWAPPED]
    assert after(contradictions, 1, order=(0, 1, 3, 2)) == [swapped]
    assert not contradictions.agrees(2, swapped)
    after(contradictions, 5, swapped)
    assert contradictions.agrees(2, swapped)
    assert contradictions.agrees(3, swapped)
    # Under this sun east and south might as well be swapped: that they agree says little about their order.
    assert not contradictions.agrees(0, [SWAPPED, SWAPPED, NONE, NONE])
    assert contradictions.agrees(0, [ODD, SWAPPED, NONE, NONE])


TURNED = {"share": (0.2, 3.0, 8.0, 0.3)}


def test_a_contradiction_that_fits_no_single_face_casts_doubt_on_all_faces_at_the_second_look():
    contradictions = Contradictions()
    torn = [TORN] * 4
    assert after(contradictions, 7, **TURNED) == [SOUND] * 5 + [torn] * 2
    assert not contradictions.agrees(0, torn)
    # A single look that agrees starts the count anew.
    after(contradictions, 5, torn)
    assert contradictions.agrees(0, torn)
    assert after(contradictions, 6, torn, **TURNED)[-4:] == [SOUND] * 4


def test_a_look_that_accuses_one_face_does_not_count_towards_doubting_all_faces():
    contradictions = Contradictions()
    after(contradictions, 5, share=(1.0, 0.3, 1.0, 1.0))
    assert after(contradictions, 6, **TURNED) == [SOUND] * 5 + [[TORN] * 4]


@pytest.mark.parametrize(("why", "found"), [(ODD, SOUND), (SWAPPED, SOUND), (OVER, [TORN] * 4), (TORN, [TORN] * 4)])
def test_all_faces_are_doubted_only_if_none_is_known_to_be_odd_or_swapped(why, found):
    assert after(Contradictions(), 6, [why, NONE, NONE, NONE], **TURNED)[-1] == found


def test_a_face_found_dead_ends_the_comparison_of_the_faces():
    contradictions = Contradictions()
    after(contradictions, 1, share=(1.0, 0.3, 1.0, 1.0))
    assert after(contradictions, 1, [DEAD, NONE, NONE, NONE], share=(1.0, 0.3, 1.0, 1.0)) == [SOUND]
    assert not contradictions.agrees(1, [DEAD, ODD, NONE, NONE])


def test_a_face_that_only_looked_frozen_beside_another_in_the_shade_is_acquitted():
    contradictions = Contradictions()
    shaded = {"share": (1.0, 0.3, 1.0, 1.0)}
    assert after(contradictions, 1, [NONE, NONE, FROZEN, NONE], **shaded) == [[NONE, ODD, NONE, NONE]]
    assert contradictions.wrongly_frozen_face == 2
    # Once the wrong face is known, or if it is the frozen one itself, no other is sought.
    after(contradictions, 5, [NONE, ODD, NONE, NONE], **shaded)
    assert contradictions.wrongly_frozen_face is None
    assert after(contradictions, 5, [NONE, FROZEN, NONE, NONE], **shaded)[-1] == SOUND
    assert contradictions.wrongly_frozen_face is None
    assert after(Contradictions(), 6, [NONE, NONE, FROZEN, FROZEN], **shaded)[-1] == SOUND
    assert after(Contradictions(), 6, [NONE, NONE, FROZEN, NONE], **TURNED)[-1] == SOUND


def test_a_face_found_dead_ends_the_acquittal_of_a_frozen_face():
    contradictions = Contradictions()
    shaded = {"share": (1.0, 0.3, 1.0, 1.0)}
    after(contradictions, 1, [NONE, NONE, FROZEN, NONE], **shaded)
    assert after(contradictions, 1, [DEAD, NONE, FROZEN, NONE], **shaded) == [SOUND]
    assert contradictions.wrongly_frozen_face is None


def test_a_frozen_face_is_used_again_only_after_all_four_agree():
    contradictions = Contradictions()
    frozen = [NONE, FROZEN, NONE, NONE]
    after(contradictions, 1, frozen, share=(1.0, 0.3, 1.0, 1.0))
    assert not contradictions.agrees(1, frozen)
    after(contradictions, 5, frozen)
    assert contradictions.agrees(1, frozen)
