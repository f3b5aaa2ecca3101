"""Causes rank before what they bring about."""

from fpplab.diagnosis import Finding, cause_named, known_causes
from fpplab.diagnosis.causes.saturated import SATURATED
from fpplab.diagnosis.causes.wrong_resolution import WRONG_RESOLUTION
from fpplab.diagnosis.ranking import rank_findings


def order(**excess: float) -> list[str]:
    found = [Finding(cause_named(name), "", value) for name, value in excess.items()]
    return [one.cause.key for one in rank_findings(found)]


def test_a_side_effect_ranks_behind_its_cause_however_much_it_exceeds_its_limit() -> None:
    assert order(wrong_resolution=5.0, camera_focus=1.1) == ["camera_focus", "wrong_resolution"]


def test_effects_of_effects_rank_behind_the_first_cause() -> None:
    assert order(interreflection=9.0, flicker=7.0, vibration=8.0)[0] == "vibration"


def test_findings_that_have_nothing_to_do_with_each_other_rank_by_their_excess() -> None:
    assert order(small_angle=2.0, ambient=3.0) == ["ambient", "small_angle"]


def test_of_bands_and_flicker_the_one_that_leaves_more_is_the_cause() -> None:
    assert order(bands=2.0, flicker=9.0) == ["flicker", "bands"]
    assert order(bands=2.0, flicker=4.0) == ["bands", "flicker"]


def test_of_flicker_and_motion_the_one_that_leaves_more_is_the_cause() -> None:
    assert order(flicker=12.2, vibration=9.0) == ["vibration", "flicker"]
    assert order(flicker=9.0, vibration=2.0) == ["flicker", "vibration"]


def test_of_bands_and_motion_the_one_that_leaves_more_is_the_cause() -> None:
    assert order(bands=8.0, vibration=1.1) == ["bands", "vibration"]
    assert order(bands=1.4, vibration=1.7) == ["vibration", "bands"]


def test_of_bands_and_a_bent_response_the_one_that_leaves_more_is_the_cause() -> None:
    assert order(bands=5.7, response=1.1) == ["bands", "response"]
    assert order(bands=1.2, response=4.0) == ["response", "bands"]


def test_light_between_surfaces_bends_fringes_but_not_the_other_way_round() -> None:
    assert order(interreflection=2.0, harmonics=1.2) == ["interreflection", "harmonics"]
    assert order(interreflection=1.1, harmonics=4.0) == ["harmonics", "interreflection"]


def test_another_rigs_calibration_is_first_unless_something_else_shifts_points() -> None:
    assert order(stale_calibration=2.0, ambient=5.0) == ["stale_calibration", "ambient"]
    assert order(stale_calibration=4.0, saturated=2.0) == ["saturated", "stale_calibration"]
    assert order(stale_calibration=40.0, saturated=2.0) == ["stale_calibration", "saturated"]


def test_a_side_effect_names_its_cause_in_the_remedy() -> None:
    found = [Finding(WRONG_RESOLUTION, "", 3.0), Finding(SATURATED, "", 2.0)]
    first, second = rank_findings(rank_findings(found))
    assert first.remedy == SATURATED.remedy
    assert second.remedy.startswith(
        "see to saturated first, which may be all that shows here; if this remains,"
    )
    assert second.remedy.endswith(second.cause.remedy)
    assert second.remedy.count("saturated") == 1


def test_every_cause_leaves_its_effects_ways_out() -> None:
    """No cause is its own effect, and mutual pairs are not decided by side effects as well."""
    known = known_causes()
    assert all(cause.key not in cause.side_effects for cause in known.values())
    pairs = [(cause, known[other]) for cause in known.values() for other in cause.outweighs_from]
    assert pairs
    assert all(b.key not in a.side_effects and a.key not in b.side_effects for a, b in pairs)


def test_side_effects_and_rivals_are_causes() -> None:
    for cause in known_causes().values():
        assert {*cause.side_effects, *cause.outweighs_from} <= set(known_causes()), cause
