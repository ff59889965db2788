"""Study: each number is computed once, and data are identified by their hash."""

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from scipy.ndimage import gaussian_filter1d

from palpate.estimation.base_model import NO_ARM, Arm
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.diagnosis.extension import PackedFit
from palpate.estimation.diagnosis.residual_checks import exceeds_noise
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.measurement_model import identify_measurement_model
from palpate.estimation.study import ModelStudy, fits, fitting, saved_diagnosis
from palpate.estimation.study.channels import channel_of
from palpate.estimation.study.saved_diagnosis import RESULT, with_checksum
from palpate.robot_io.errors import InputError
from tests.estimation.fits import cubic
from tests.estimation.presses import session
from tests.estimation.searches import searched
from tests.estimation.study.joints import joints
from tests.few_effects import try_few_effects
from tests.palpate.presses import write_presses

NOON = datetime(2026, 1, 2, 12, tzinfo=UTC)


@pytest.fixture(scope="module", autouse=True)
def few_effects():
    with pytest.MonkeyPatch.context() as patch:
        try_few_effects(patch)
        yield


@pytest.fixture(scope="module")
def pressed():
    """A stiffening object, diagnosed."""
    study = ModelStudy(session(4, cubic), "kelvin_voigt", now=lambda: NOON)
    return study, study.diagnose()


@pytest.fixture(scope="module")
def arm():
    """A contact that is explained and two joints of which one rubs, all diagnosed by default."""
    study = ModelStudy([session(4), *joints(friction_nm=(0.0, 0.4))])
    return study, study.diagnose()


def test_fit_from_another_process_has_all_derived_signals():
    effects = ["load_dependent_friction"]
    own = {name: EFFECTS[name]() for name in effects}
    there, here = (ModelStudy(joints((0.4,)), "pendulum", effects=own) for _ in range(2))
    made, one = there.fit("joint_1", effects), here.channel("joint_1")
    assert "load_dependent_friction.link_share" in made.values  # the form that knows rotor and link apart
    here.take_fit(one, effects, PackedFit.of(made))
    assert np.array_equal(here.fit(one, effects).predicted, made.predicted)


def test_one_model_has_one_fit_for_every_caller(pressed):
    study, diagnosis = pressed
    (found,), (one,) = diagnosis.channels, study.channels
    base = study.fit("contact")
    assert study.compare()["contact"].fitted is base
    change = study.add("cubic_stiffness", fresh=True)
    assert change.result.stages[0].fitted is base
    assert change.result.stages[1].fitted is study.fit(one, ["cubic_stiffness"])
    assert change.result.comparison is study.compare()["contact"]
    (accepted,) = found.accepted
    assert (accepted.effect, found.baseline.rmse) == ("cubic_stiffness", base.rmse)
    added = change.result.stages[1].rmse
    assert accepted.rmse_before == base.rmse
    assert accepted.rmse_after == found.final.rmse == added == change.revisions[-1].rmse
    k3 = change.revisions[-1].parameters["cubic_stiffness.k3"]
    assert (k3.value, k3.std_err) == (accepted.parameters["k3"].value, accepted.parameters["k3"].std_err)


def test_ranking_matches_the_added_effect(pressed):
    study, diagnosis = pressed
    for entry in diagnosis.channels[0].ranking[:5]:
        assert entry.rmse_held_out == study.fit("contact", [entry.effect]).rmse
        assert entry.score == pytest.approx(1 - entry.rmse_held_out / study.fit("contact").rmse)


def test_channel_has_one_noise(pressed):
    study, diagnosis = pressed
    change = study.add("bias", fresh=True)
    found = diagnosis.channels[0]
    levels = {study.compare()["contact"].noise.value, found.noise_floor, found.floor.value}
    levels |= {
        change.result.noise.value,
        change.result.extended_comparison.noise.value,
        study.noise("contact").value,
    }
    levels |= {revision.noise_floor for revision in study.revisions}
    levels |= {one.noise.value for one in study.estimate("lsq")}
    assert len(levels) == 1


def test_every_compared_channel_is_diagnosed(arm):
    study, diagnosis = arm
    assert [one.channel for one in diagnosis.channels] == [one.channel for one in study.compare().channels]
    for found in diagnosis.channels:
        compared = study.compare()[found.channel]
        assert (found.baseline.rmse, found.noise_floor) == (compared.rmse, compared.noise.value)
    assert "coulomb_friction" in [entry.effect for entry in diagnosis.channels[2].accepted]


def test_effect_is_added_to_the_diagnosed_or_a_suitable_or_the_requested_channel(arm):
    study, _ = arm
    with pytest.raises(InputError, match="viscous_friction can be added to joint_1, joint_2; choose one"):
        study.add("viscous_friction")
    assert study.add("bias").result.channel.name == "contact"
    assert study.add("bias", channel="joint_1").result.channel.name == "joint_1"
    change = study.add("coulomb_friction")
    assert change.result.channel.name == "joint_2"  # in which the diagnosis named it
    assert change.result.stages[1].rmse < 0.2 * change.result.stages[0].rmse
    with pytest.raises(InputError, match=r"no such channel. Available: contact, joint_1, joint_2"):
        study.add("bias", channel="joint_9")


def test_adding_continues_the_newest_revision_and_removing_reverts():
    study = ModelStudy(session(4, cubic), now=lambda: NOON)
    study.add("bias")
    study.add("cubic_stiffness")
    undone = study.remove("bias")
    assert undone.result.added == ["cubic_stiffness"]
    assert undone.revisions[0].rmse == study.fit("contact", ["cubic_stiffness"]).rmse
    told = [(one.number, one.parent, one.added, one.removed, one.effects) for one in study.revisions]
    assert told == [
        (0, None, "", "", []),
        (1, 0, "bias", "", ["bias"]),
        (2, 1, "cubic_stiffness", "", ["bias", "cubic_stiffness"]),
        (3, 2, "", "bias", ["cubic_stiffness"]),
    ]
    assert study.add("quadratic_damping").revisions[0].effects == ["cubic_stiffness", "quadratic_damping"]
    assert study.add("quadratic_damping", start=0).revisions[0].parent == 0
    assert study.revisions[0].created_utc == "2026-01-02T12:00:00+00:00"
    with pytest.raises(InputError, match="the newest models do not have this effect"):
        study.remove("adhesion")


@pytest.mark.parametrize(
    ("effects", "how", "words"),
    [
        (["magic"], {}, "magic"),
        (["coulomb_friction"], {}, r"does not apply to any channel \(contact\)"),
        (
            ["bias", "recorded_dependence"],
            {},
            r"\(contact\), because recorded_dependence cannot be identified from these data\. Effects",
        ),
        (["stiffness"], {}, "would contain stiffness twice"),
        (["bias", "bias"], {}, "would contain bias twice"),
        (["bias"], {"start": 3}, "no revision 3"),
        (["bias"], {"start": 0, "fresh": True}, "--fresh and --from 0: give only one"),
        (["bias"], {"start": 1}, "revision 1 already contains bias"),
    ],
)
def test_invalid_effects_are_refused_and_nothing_is_saved(effects, how, words):
    study = ModelStudy(session(4))
    study.add("bias") if "start" in how else None
    before = study.revisions
    with pytest.raises(InputError, match=words):
        study.add(*effects, **how)
    assert study.revisions == before


def test_data_are_identified_by_arrays_and_joints_also_by_arm():
    data, (joint, _) = session(4), joints()
    moved = replace(data, effort=data.effort + np.r_[1e-5, np.zeros(len(data) - 1)])
    turned = replace(data, effort=data.effort[::-1].copy())
    (one,), (same,), *others = (ModelStudy(each).channels for each in (data, session(4), moved, turned))
    assert one.sha256 == same.sha256
    assert len({one.sha256, *(other.sha256 for (other,) in others)}) == 3
    # What another processor or version of a library computes from the same file differs in its last digits.
    rounded = replace(data, velocity=data.velocity * (1 + 1e-14), phase=np.zeros(len(data), int))
    assert ModelStudy(rounded).channels[0].sha256 == one.sha256
    of_arms = {
        ModelStudy(joint, "inertia", arm=arm).channels[0].sha256 for arm in (NO_ARM, Arm(tip_frame="x"))
    }
    assert len(of_arms) == 2
    assert len({ModelStudy(data, arm=arm).channels[0].sha256 for arm in (NO_ARM, Arm(tip_frame="x"))}) == 1


@pytest.mark.slow
def test_revisions_are_continued_only_for_the_same_data(tmp_path):
    study = ModelStudy(session(4, cubic), folder=tmp_path)
    found = study.diagnose(apply=True)
    (tmp_path / RESULT).write_text(json.dumps(study.diagnosis_data(found)))
    again, other = (ModelStudy(session(seed, cubic), folder=tmp_path) for seed in (4, 5))
    assert again.known_diagnosis(again.channels[0]) == found.channels[0]
    assert again.results()[0].added == ["cubic_stiffness"]
    assert again.add("bias").parent.number == 1
    assert other.known_diagnosis(other.channels[0]) is None
    assert other.results()[0].added == []
    with pytest.raises(InputError, match="revision 1 is from other data"):
        other.add("bias", start=1)
    assert other.add("bias").revisions[0].parent is None
    (tmp_path / RESULT).write_text("{}")
    with pytest.raises(InputError, match="damaged"):
        again.results()


def forge(file: Path, change: Callable[[dict], object]) -> None:
    """Change a file as one does who wants to deceive: the checksum is that of the new content."""
    content = json.loads(file.read_text())
    del content["sha256"]
    change(content)
    file.write_text(json.dumps(with_checksum(content)))


def test_numbers_of_a_forged_diagnosis_are_checked_against_the_data(pressed, tmp_path):
    study, found = pressed
    content = study.diagnosis_data(found)
    again = ModelStudy(session(4, cubic), folder=tmp_path)
    for change, words in (
        (lambda entry: entry.update(noise_floor=0.5), "its noise is 0.5, but these data give 0.0"),
        (lambda entry: entry["baseline"].update(rmse=9.0), "its error is 9, but these data give"),
        (lambda entry: entry["final"].update(rmse=9.0), "its error is 9, but these data give"),
        (
            lambda entry: entry["final"]["parameters"]["cubic_stiffness.k3"].update(value=1.0),
            r"its cubic_stiffness\.k3 is 1, but these data give",
        ),
    ):
        (tmp_path / RESULT).unlink(missing_ok=True)
        (tmp_path / RESULT).write_text(json.dumps(content))
        assert again.known_diagnosis(again.channels[0]) == found.channels[0]
        forge(tmp_path / RESULT, lambda content, change=change: change(content["channels"][0]))
        with pytest.raises(InputError, match=words):
            again.known_diagnosis(again.channels[0])


def test_diagnosis_changed_by_hand_is_refused(pressed, tmp_path):
    study, found = pressed
    content = study.diagnosis_data(found)
    content["channels"][0]["verdict"] = "unexplained"
    (tmp_path / RESULT).write_text(json.dumps(content))
    again = ModelStudy(session(4, cubic), folder=tmp_path)
    with pytest.raises(InputError, match=r"damaged \(sha256: .* changed after palpate wrote it"):
        again.known_diagnosis(again.channels[0])


def test_saved_channel_without_identity_is_damaged(pressed, tmp_path):
    study, found = pressed
    (tmp_path / RESULT).write_text(json.dumps(study.diagnosis_data(found)))
    forge(tmp_path / RESULT, lambda content: content["judged"].clear())
    again = ModelStudy(session(4, cubic), folder=tmp_path)
    with pytest.raises(InputError, match=r"damaged \(judged: has no entry for contact\); delete it"):
        again.known_diagnosis(again.channels[0])


def test_saved_diagnosis_is_read_again_only_after_a_change(pressed, tmp_path, monkeypatch):
    study, found = pressed
    (tmp_path / RESULT).write_text(json.dumps(study.diagnosis_data(found)))
    read, plain = [], saved_diagnosis.read_saved
    monkeypatch.setattr(saved_diagnosis, "read_saved", lambda *args: read.append(args) or plain(*args))
    first, second = (saved_diagnosis.read_saved_diagnoses(tmp_path) for _ in range(2))
    assert (list(first.values()), len(read)) == (found.channels, 1)
    assert second == first
    forge(tmp_path / RESULT, lambda content: content.update(channels=[]))
    assert saved_diagnosis.read_saved_diagnoses(tmp_path) == {}


def test_numbers_of_a_forged_revision_are_checked_against_the_data(pressed):
    study, _ = pressed
    made = study.add("cubic_stiffness", fresh=True).revisions[-1]
    study.check(made)
    k = made.parameters["stiffness.k"].model_copy(update={"value": 777.0})
    forged = made.model_copy(update={"parameters": made.parameters | {"stiffness.k": k}})
    with pytest.raises(InputError, match=r"revision \d+: its stiffness\.k is 777, but these data give"):
        study.check(forged)


def test_concurrent_threads_fit_a_model_once(monkeypatch):
    calls = []

    def counted(module, name):
        plain = getattr(module, name)
        return lambda *args: calls.append(name) or plain(*args)

    for module, name in ((fitting, "fit_base"), (fits, "fit_extended")):
        monkeypatch.setattr(module, name, counted(module, name))
    study = ModelStudy(session(4))
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: study.fit("contact", ["bias"]), range(16)))
    assert calls == ["fit_base", "fit_extended"]
    assert len({id(one) for one in found}) == 1


class DictLike:
    """What a data frame of any library has: columns by name."""

    def __init__(self, columns):
        self._columns = columns
        self.columns = list(columns)

    def __getitem__(self, name):
        return self._columns[name]


@pytest.mark.parametrize("made", [dict, pa.table, DictLike], ids=["dict", "pyarrow", "frame"])
def test_table_in_memory_is_read_like_its_file(made, tmp_path):
    path = write_presses(tmp_path / "p.csv")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    names = ("time_s", "displacement_m", "load", "run")
    options = ImportOptions(columns={"force_N": "load"})
    study = ModelStudy(made(dict(zip(names, rows.T, strict=True))), options=options)
    (one,), (of_file,) = study.channels, ModelStudy(path).channels
    assert (one.sha256, one.model.name) == (of_file.sha256, of_file.model.name)
    for signal in ("time_s", "position", "velocity", "acceleration", "effort", "run"):
        np.testing.assert_array_equal(getattr(one.data, signal), getattr(of_file.data, signal))


def test_rejected_channel_is_reported_next_to_the_others():
    study = ModelStudy([session(4).select(np.arange(50)), *joints()])
    found = study.compare()
    assert [one.channel for one in found.channels] == ["joint_1", "joint_2"]
    assert "only 50 samples" in found.failures["contact"]
    assert "only 50 samples" in found._repr_html_()
    assert "only 50 samples" in study.results()[0].reason


def test_results_are_tables_in_a_notebook(pressed):
    study, diagnosis = pressed
    for result, words in (
        (study, "kelvin_voigt"),
        (study.compare(), "x noise"),
        (diagnosis, "cubic_stiffness"),
        (study.add("cubic_stiffness", fresh=True), "+ cubic_stiffness"),
        (study.revisions, "kelvin_voigt + cubic_stiffness"),
        (diagnosis.channels[0], "cubic_stiffness.k3"),
        (study.estimate("lsq"), "stiffness.k"),
        (study.estimate("lsq")[0], "stiffness.k"),
        (study.results(), "+ cubic_stiffness"),
    ):
        assert words in result._repr_html_()
        assert result._repr_html_().startswith("<table>")
        assert words in str(result)
        assert max(map(len, str(result).splitlines())) <= 110


def pulled_springs(motion_m):
    """Three runs on each of three springs, with steps of a micrometer and a force sensor that filters."""
    t, run = np.tile(np.arange(82) * 0.9, 9), np.repeat(np.arange(9), 82)
    x = np.round(motion_m(t) / 1e-6) * 1e-6
    motion = differentiate(t, x, run)
    stiffness = np.array([4e3, 5e3, 6e3])[run // 3]
    noise = gaussian_filter1d(np.random.default_rng(1).normal(0.0, 8.0, (9, 82)), 3.0, axis=1).ravel()
    force = stiffness * x * (1.0 - 2.0 * x) + noise
    derived = (motion.velocity, motion.acceleration)
    return ChannelData("joint_1", ChannelKind.PRISMATIC, t, x, *derived, force, run, np.full(len(x), -1))


def test_inertia_is_held_at_zero_if_the_acceleration_is_only_reading_error():
    for speed_m_s in (0.0018, 0.0018123):  # whole steps between readings, and rounded ones
        steady = channel_of(pulled_springs(lambda t, v=speed_m_s: v * t), "spring_mass_damper", NO_ARM)
        assert steady.model.held == {"inertia.m": 0.0}
    swinging = channel_of(pulled_springs(lambda t: 0.06 - 0.06 * np.cos(t)), "spring_mass_damper", NO_ARM)
    assert not swinging.model.held


def test_smooth_residual_is_no_noise_even_if_the_velocity_was_smoothed_over_most_of_a_run():
    channel = channel_of(pulled_springs(lambda t: 0.0018 * t), "spring_mass_damper", NO_ARM)
    start = searched(channel.data, base=channel.model).start
    excess = exceeds_noise(start, identify_measurement_model(channel.data), np.random.default_rng(0))
    assert excess.acting == pytest.approx(start.rmse, rel=0.1)


def test_held_inertia_stays_held_in_every_fit_and_is_reported():
    study = ModelStudy(pulled_springs(lambda t: 0.0018123 * t), "spring_mass_damper")
    (channel,) = study.channels
    assert study.fit_held(channel, [], {"damping.c": 0.0}).values["inertia.m"] == 0.0
    (estimated,) = study.estimate("lsq")
    assert set(estimated.model.gains) == {"stiffness.k", "damping.c"}
    assert any("the inertia is held at 0" in warning for warning in study.warnings["joint_1"])
