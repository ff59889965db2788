"""A dead band of the force sensor that the joints show is in the contact's own answer too."""

import numpy as np
import pytest
from estimation.diagnosis.dead_band import swallowing, with_dead_band
from estimation.diagnosis.judged import Judged

from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.effects.contact_offset import ContactOffset
from estimation.model import Model
from tests.estimation.diagnosis.test_robot import ARM
from tests.estimation.diagnosis.test_true_force import EVERY, STIFFNESS_N_M, WIDTH_N, pressing
from tests.estimation.fits import fits

SPRING = (EFFECTS["stiffness"](), EFFECTS["damping"](), ContactOffset())
KELVIN_VOIGT = Model("kelvin_voigt", SPRING)
FEW = [EFFECTS[name]() for name in ("force_deadband", "deadband", "bias", "cubic_stiffness")]


@pytest.fixture(scope="module")
def seen():
    """A contact that takes the dead band for a deeper surface, and a joint that knows better."""
    contact, joint, _ = pressing(noise_n=0.02, noise_nm=0.02)
    pairs = [(contact, KELVIN_VOIGT), (joint, ARM)]
    return [Judged(*pair, judge(*pair)) for pair in pairs]


def judge(data, model):
    return diagnose(data, model, FEW, rng=np.random.default_rng(1)).channels[0]


def again(judged):
    return with_dead_band(judged, FEW, lambda number, data, model: judge(data, model))


def test_the_contact_is_judged_again_under_the_sensor_that_the_joint_shows(seen):
    contact, joint = again(seen)
    assert joint is seen[1]
    (entry,) = contact.found.accepted
    assert (contact.found.verdict, entry.effect, entry.told_by) == (Verdict.MISSING, "deadband", ["joint_1"])
    assert entry.parameters["width"].value == pytest.approx(WIDTH_N, rel=0.05)
    assert contact.found.final.rmse <= 1.02 * seen[0].found.baseline.rmse
    assert contact.found.baseline == seen[0].found.baseline
    assert "joint_1" in contact.found.reason


def test_what_is_refitted_stage_by_stage_has_that_width_too(seen):
    contact = again(seen)[0]
    last = fits(contact.data, contact.model, ["deadband"], EVERY)[-1]
    width = contact.found.accepted[0].parameters["width"].value
    assert last.parameters["deadband.width"].value == pytest.approx(width)
    assert last.parameters["stiffness.k"].value == pytest.approx(STIFFNESS_N_M, rel=0.01)
    assert last.rmse == pytest.approx(contact.found.final.rmse, rel=0.02)


def test_a_contact_keeps_its_own_answer_where_that_is_better(seen):
    contact, joint = seen
    unsure = [entry.model_copy(update={"confused_with": ["torque_gain"]}) for entry in joint.found.accepted]
    doubtful = Judged(joint.data, joint.model, joint.found.model_copy(update={"accepted": unsure}))
    assert again([contact, doubtful])[0] is contact
    assert with_dead_band([contact], FEW, fail)[0] is contact
    worse = contact.found.baseline.model_copy(update={"rmse": 0.01 * contact.found.baseline.rmse})
    exact = Judged(contact.data, contact.model, contact.found.model_copy(update={"baseline": worse}))
    assert again([exact, joint])[0] is exact


def fail(*_):
    raise AssertionError


def test_an_effect_of_known_width_stays_there_and_finds_its_way_from_nothing(seen):
    marked = swallowing(seen[0].data, WIDTH_N, 0.01)
    known = EFFECTS["deadband"]().suited_to(marked)
    (base,) = fits(marked, Model("known", (*SPRING, known)), ())
    width = base.parameters["deadband.width"]
    assert (width.value, width.std_err) == (WIDTH_N, 0.01)
    assert base.parameters["stiffness.k"].value == pytest.approx(STIFFNESS_N_M, rel=0.01)


def test_how_deep_the_surface_lies_is_no_surer_than_the_width_that_was_told(seen):
    """A dead band that is wider by 0.05 N is a surface that is higher by 0.05 N over the stiffness."""
    offsets = []
    for std_err_n in (0.0, 0.05):
        marked = swallowing(seen[0].data, WIDTH_N, std_err_n)
        offsets.append(fits(marked, KELVIN_VOIGT, ["deadband"], FEW)[-1].parameters["contact_offset.offset"])
    assert offsets[1].std_err == pytest.approx(np.hypot(offsets[0].std_err, 0.05 / STIFFNESS_N_M), rel=0.05)
