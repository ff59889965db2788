"""`palpate compare A B`: two measurements, or two models of one, side by side."""

import json
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from rerun.chunk import RrdReader

from palpate.estimation.estimate import ParameterEstimate
from palpate.estimation.study.paired_comparison import ParameterDifference, compare_pairs
from palpate.render.paired import _compare_parameters
from palpate.study import Study
from tests.palpate import synthetic
from tests.palpate.cli import as_json, assert_refused, done, next_commands, run
from tests.palpate.presses import NOISE_N, press_columns, write_presses, write_table
from tests.palpate.sessions import synthetic_session


def law(stiffness):
    return lambda x, v: stiffness * x + 6.0 * v


def made_once(name, stiffness, seed):
    """A fixture of a file of presses."""

    @pytest.fixture(scope="module", name=name)
    def made(tmp_path_factory):
        path = tmp_path_factory.mktemp(name) / f"{name}.csv"
        return write_presses(path, force_of=law(stiffness), seed=seed)

    return made


soft, stiff, again = made_once("soft", 400.0, 1), made_once("stiff", 440.0, 2), made_once("again", 400.0, 3)


@cache
def study_of(path, model):
    """A study and its fits, of a file that several tests look at."""
    return Study(path, model, keep=False)


def sides(one, other, first=None, second=None):
    return compare_pairs(study_of(one, first), study_of(other, second), ("a", "b"))[0]


def differences(*sides_of):
    """Differences of parameters by their names."""
    return {one.name: one for one in sides(*sides_of).differences}


def test_differing_parameter_is_identified_with_its_interval(soft, stiff):
    found = differences(soft, stiff)
    assert found["stiffness.k"].value == pytest.approx(40.0, abs=found["stiffness.k"].half)
    assert found["stiffness.k"].differs
    assert not found["damping.c"].differs
    assert sides(soft, stiff).difference_in_noise > 3.0


def test_repetition_shows_no_difference_and_agrees_within_noise(soft, again):
    found = sides(soft, again)
    assert not any(one.differs for one in found.differences)
    assert found.agreement_percent == pytest.approx(
        100 * (1 - 0.02 * np.sqrt(2) / found.first.data.effort.std()), abs=0.1
    )
    assert found.difference_in_noise == pytest.approx(1.0, abs=0.1)
    (own, of_other), (other_of, other_own) = found.fit_matrix
    assert own == pytest.approx(other_own, abs=0.3)
    assert of_other == pytest.approx(own, abs=0.3)
    assert other_of == pytest.approx(own, abs=0.3)


@pytest.mark.parametrize(("change", "name"), [((402.0, 6.0), "stiffness.k"), ((400.0, 6.5), "damping.c")])
def test_difference_below_the_noise_that_a_parameter_shows_is_no_repetition(soft, tmp_path, change, name):
    k, c = change
    other = write_presses(tmp_path / "other.csv", force_of=lambda x, v: k * x + c * v, seed=8)
    found = sides(soft, other)
    assert found.difference_in_noise < 1.2
    assert [one.name for one in found.differences if one.differs] == [name]
    said = " ".join(run("compare", soft, other).stdout.split())
    assert f"{name} differs" in said
    assert "B repeats A with a fit" in said
    assert "only noise" not in said
    assert "noise of both" not in said


def test_slow_deviation_below_the_noise_is_no_repetition(soft, again, tmp_path):
    """The deviation is smaller than the noise of the difference, and is no change of a parameter."""
    assert sides(soft, again).repeats
    columns = press_columns(again)
    wave = 1.1 * NOISE_N * np.sqrt(2.0) * np.sin(2.0 * np.pi * 9.0 * columns["time_s"])
    columns["force_N"] += np.where(columns["displacement_m"] > 0.0, wave, 0.0)
    found = sides(soft, write_table(tmp_path / "wave.csv", **columns))
    assert not any(one.differs for one in found.differences)
    assert found.difference_in_noise < 1.2
    assert not found.repeats


def test_surface_of_two_sessions_is_compared_as_a_position(tmp_path, monkeypatch):
    """Each session's offset counts from the surface detected in it, which hides that the object moved."""
    near = synthetic_session(tmp_path / "near.mcap")
    monkeypatch.setattr(synthetic, "SURFACE_M", synthetic.SURFACE_M - 0.002)
    studies = [
        Study(each, "kelvin_voigt", keep=False) for each in (near, synthetic_session(tmp_path / "far.mcap"))
    ]
    (pair,) = compare_pairs(*studies, ("near", "far"))
    found = {one.name: one for one in pair.differences}
    assert "contact_offset.offset" not in found
    place = found["surface.position"]
    assert place.first.value == pytest.approx(-0.12, abs=2e-5)  # along the press, which points downwards
    assert place.value == pytest.approx(0.002, abs=2.0 * place.half)
    assert place.half < 3e-5
    assert place.differs
    (said,) = (words for words in _compare_parameters(pair, lacks_effects=False) if "surface" in words)
    assert "%" not in said


def test_common_model_error_cancels_in_paired_differences(tmp_path):
    """A hidden cubic term makes each stiffness uncertain by 100 N/m, and the difference by less than one."""

    def hardening(stiffness, seed):
        return write_presses(
            tmp_path / f"{stiffness}-{seed}.csv",
            force_of=lambda x, v: stiffness * x + 6.0 * v + 2e6 * x**3,
            seed=seed,
            speeds_m_s=(0.04, 0.08, 0.06),
        )

    found = differences(hardening(400.0, 1), hardening(400.0, 11))
    assert all(abs(one.value) < one.half for one in found.values())
    one = found["stiffness.k"]
    assert one.half < 1.0 < 20.0 < np.hypot(one.first.std_err, one.second.std_err)
    found = differences(hardening(400.0, 1), hardening(405.0, 12))
    assert found["stiffness.k"].differs
    assert found["stiffness.k"].value == pytest.approx(5.0, abs=0.6)


def test_paired_interval_is_that_of_white_noise_in_both(soft, again):
    """Noise is all that differs: the errors are those of sqrt(2) times the noise, (X'X)^-1 its size."""
    pair = sides(soft, again)
    fitted = pair.first.compared.fitted
    rows = fitted.scored & (fitted.data.position > 0.0)
    motion = np.column_stack([fitted.data.position, fitted.data.velocity])[rows]
    expected = NOISE_N * np.sqrt(2.0 * np.diag(np.linalg.inv(motion.T @ motion)))
    found = {one.name: one for one in pair.differences}
    paired = [found[name].paired_std_err for name in ("stiffness.k", "damping.c")]
    np.testing.assert_allclose(paired, expected, rtol=0.25)
    assert [found[name].half for name in ("stiffness.k", "damping.c")] == pytest.approx(
        [1.96 * std_err for std_err in paired]
    )


def test_errors_of_two_measurements_add_as_squares():
    sides_of_k = [
        ParameterEstimate("stiffness.k", "N/m", value, std_err, (value - 2 * std_err, value + 2 * std_err))
        for value, std_err in ((400.0, 3.0), (410.0, 4.0))
    ]
    difference = ParameterDifference("stiffness.k", "N/m", *sides_of_k)
    assert difference.value == 10.0
    assert difference.half == pytest.approx(1.96 * 5.0)
    assert difference.differs
    of_one = ParameterDifference("stiffness.k", "N/m", *sides_of_k, is_same_data=True)
    assert of_one.value == 10.0
    assert np.isnan(of_one.half)  # the errors of two models of one measurement are not independent
    lacking = ParameterDifference("bias.offset", "N", None, None)
    assert np.isnan(lacking.value)
    assert of_one.differs is lacking.differs is None


@pytest.mark.parametrize(("first", "share"), [(10.0, "(+50 %)"), (0.1, ""), (-0.1, ""), (-10.0, "(+50 %)")])
def test_difference_from_a_value_near_zero_has_no_percentage(first, share):
    pair = [
        ParameterEstimate("bias.value", "N", value, 1.0, (value - 2.0, value + 2.0))
        for value in (first, first + 5.0)
    ]
    difference = ParameterDifference("bias.value", "N", *pair)
    sides = SimpleNamespace(differences=[difference])
    told = list(_compare_parameters(sides, lacks_effects=False))
    assert told == [f"bias.value differs: 5.0 ± 2.8 N {share}.".replace(" .", ".")]
    (doubtful,) = _compare_parameters(sides, lacks_effects=True)
    assert doubtful.endswith(", which may come from missing effects.")


def test_another_motion_is_not_paired(soft, again, tmp_path):
    columns = press_columns(again)
    more = {name: 1.5 * columns[name] for name in ("displacement_m", "force_N")}
    deeper = write_table(tmp_path / "deeper.csv", **columns | more)
    assert all(one.paired_std_err is not None for one in sides(soft, again).differences)
    assert all(one.paired_std_err is None for one in sides(soft, deeper).differences)


def test_invisible_difference_is_none_and_noise_is_not_given_in_percent(tmp_path):
    first = write_presses(tmp_path / "first.csv")
    columns = press_columns(first)
    columns["force_N"] += 1e-4 * columns["displacement_m"]
    second = write_table(tmp_path / "second.csv", **columns)
    found = differences(first, second)
    assert abs(found["stiffness.k"].value) > found["stiffness.k"].half  # rounding alone is beyond it
    assert not any(one.differs for one in found.values())
    said = " ".join(run("compare", first, second).stdout.split())
    assert "differ by no more than the noise of both" in said
    assert "No parameter differs" in said
    assert "B repeats A with a fit" not in said


def test_model_of_another_object_fits_worse(soft, stiff):
    (own, of_other), (other_of, other_own) = sides(soft, stiff).fit_matrix
    assert min(own, other_own) > 98.0
    assert max(of_other, other_of) < 90.0
    # the truth: B's force is 40 x above A's model
    data = sides(soft, stiff).second.data
    left = np.where(data.position > 0, 40.0 * data.position, 0.0)
    expected = 100 * (1 - np.linalg.norm(left) / np.linalg.norm(data.effort - data.effort.mean()))
    assert of_other == pytest.approx(expected, abs=0.5)


def test_residual_is_white_only_for_a_complete_model(soft, hardening):
    found = sides(soft, hardening)
    assert found.first.autocorrelation.outside < 0.1
    assert found.second.autocorrelation.outside > 0.5


def test_other_times_are_no_repetition(soft, tmp_path):
    quick = write_presses(tmp_path / "quick.csv", speeds_m_s=(0.05, 0.06, 0.09, 0.07), force_of=law(400.0))
    assert sides(soft, quick).overlay is None
    three = write_presses(tmp_path / "three.csv", speeds_m_s=(0.02, 0.04, 0.08), force_of=law(400.0))
    assert sides(soft, three).overlay is None
    assert sides(soft, three).fit_matrix[0][1] > 97.0


def test_shifted_and_shortened_repetition_is_aligned_run_by_run(soft, again, tmp_path):
    table = press_columns(again)
    time_s, run_number = table["time_s"], table["run"]
    rows = time_s < 0.96 * np.array([time_s[run_number == run].max() for run in run_number])
    table["time_s"] = time_s + 7.0
    cut = write_table(tmp_path / "cut.csv", **{name: column[rows] for name, column in table.items()})
    whole, later = sides(soft, again).overlay, sides(soft, cut).overlay
    assert later is not None
    known = np.isfinite(later)
    assert np.mean(known) == pytest.approx(0.96, abs=0.005)
    np.testing.assert_allclose(later[known], whole[known], atol=1e-6)


def test_difference_is_compared_with_the_noisier_of_both(soft, again, tmp_path):
    columns = press_columns(again)
    columns["force_N"] += np.random.default_rng(5).normal(0.0, 10 * NOISE_N, len(columns["force_N"]))
    loud = write_table(tmp_path / "loud.csv", **columns)
    for pair in (sides(soft, loud), sides(loud, soft)):
        found = {one.name: one for one in pair.differences}["stiffness.k"]
        fitted = pair.first.compared.fitted
        pressed = np.where(fitted.data.position > 0.0, fitted.data.position, 0.0)[fitted.scored]
        change_n = abs(found.value) * np.sqrt(np.mean(pressed**2))
        assert found.noise_levels == pytest.approx(change_n / (10 * NOISE_N), rel=0.15)


def test_model_describes_its_measurement_by_held_out_runs(hardening):
    side = sides(hardening, hardening, "kelvin_voigt", "hunt_crossley").first
    fitted = side.compared.fitted
    effort, left = fitted.data.effort[fitted.scored], fitted.residual[fitted.scored]
    expected = 100 * (1 - np.linalg.norm(left) / np.linalg.norm(effort - effort.mean()))
    assert side.fit_of(side) == pytest.approx(expected, abs=1e-6)
    in_sample = (fitted.data.effort - fitted.predicted)[fitted.scored]
    assert np.linalg.norm(in_sample) < np.linalg.norm(left)


def test_few_samples_have_no_model_and_are_overlaid(tmp_path):
    files = [
        write_presses(tmp_path / f"{n}.csv", speeds_m_s=(0.02,), force_of=law(400.0), seed=n) for n in (1, 2)
    ]
    for file in files:
        header, *rows = file.read_text().splitlines()
        file.write_text("\n".join([header, *rows[::16]]) + "\n")
    found = sides(*files)
    assert "samples; record at least 60" in found.first.reason
    assert found.differences == ()
    assert found.agreement_percent > 95.0
    assert "A has no model" in done("compare", *files, "--out", tmp_path / "there").stdout


def test_command_prints_and_writes_the_same(soft, stiff, tmp_path):
    result = done("compare", soft, stiff, "--channel", "contact", "--out", tmp_path)
    assert "stiffness.k differs: 39.9" in " ".join(result.stdout.split())
    kept = json.loads((tmp_path / "comparison.json").read_text())
    assert kept == as_json("compare", soft, stiff)
    (channel,) = kept["channels"]
    difference = next(one for one in channel["parameters"] if one["name"] == "stiffness.k")["difference"]
    assert difference["interval"][0] < 40.0 < difference["interval"][1]
    assert difference["differs"] is True
    report = (tmp_path / "report.html").read_text()
    assert "--channel contact" in report  # the command that makes the report again
    assert "soft.csv and stiff.csv" in report
    assert all(title in report for title in ("Contact force over depth", "Autocorrelation", "B as measured"))
    entities = {chunk.entity_path for chunk in RrdReader(tmp_path / "sides.rrd").stream().to_chunks()}
    assert {"/contact/effort/A", "/contact/effort/B", "/contact/residual/B"} <= entities


def test_printed_command_can_be_repeated(hardening):
    result = run("compare", hardening, "--other-model", "hunt_crossley")
    words = next_commands(result)[0]
    assert words[-2:] == ["--out", "FOLDER"]
    assert run(*words[:-2]).stdout == result.stdout


def test_proposed_commands_keep_model_and_channel(soft, stiff):
    chosen = ("--model", "hunt_crossley", "--channel", "contact")
    alone = [words for words in next_commands(run("compare", soft, stiff, *chosen)) if "--out" not in words]
    files = [words[1] for words in alone]
    assert files == [str(soft), str(stiff)]
    for words in alone:
        assert (words[words.index("--model") + 1], words[words.index("--channel") + 1]) == chosen[1::2]


def test_large_differences_are_shown_as_plain_percent(soft, tmp_path):
    hard = write_presses(tmp_path / "hard.csv", force_of=law(2000.0), seed=4)
    assert "N/m (+400 %)." in run("compare", soft, hard).stdout


@pytest.mark.slow
def test_extended_models_are_compared(hardening, tmp_path):
    softer = write_presses(tmp_path / "softer.csv", cubic=1e6, seed=8)
    base = run("compare", hardening, softer).stdout
    assert "the model's parameters may be far from the true values. Add the missing effects" in " ".join(
        base.split()
    )
    assert "cubic_stiffness" not in base
    run("add", hardening, "cubic_stiffness", "--out", tmp_path / "there")
    kept = ("--folder", tmp_path / "there", "--revision", 1)
    (channel,) = as_json("compare", hardening, softer, *kept)["channels"]
    assert channel["models"] == 2 * ["kelvin_voigt + cubic_stiffness"]
    (k3,) = [one for one in channel["parameters"] if one["name"] == "cubic_stiffness.k3"]
    assert k3["difference"]["value"] == pytest.approx(-1e6, rel=0.1)
    stages = run("compare", hardening, *kept, "--other-revision", 0)
    assert "B  hardening.csv: kelvin_voigt\n" in stages.stdout
    assert "where its base model fails" in " ".join(stages.stderr.split())
    assert run(*next_commands(stages)[0][:-2]).stdout == stages.stdout
    assert_refused(run("compare", hardening, softer, *kept, "--other-revision", 1), "no revision 1")


def test_fit_limited_by_noise_is_reported(soft, tmp_path):
    weak = write_presses(tmp_path / "weak.csv", force_of=lambda x, v: 10.0 * x + 0.0 * v, seed=5)
    said = run("compare", soft, weak).stdout
    assert "leaves only noise on B" in " ".join(said.split())
    assert said.count("only noise") == 2  # the sentence, and the cell of the table


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("SOFT", "SOFT"), ("the same measurement", "--other-model", "--split")),
        (("SOFT", "none.csv"), ("none.csv: no such file",)),
        (("SOFT", "STIFF", "--revision", 7), ("no revision 7",)),
        (("SOFT", "STIFF", "--revision", 7, "--model", "kelvin_voigt"), ("leave out --model",)),
        (("SOFT", "STIFF", "--channel", "joint_1"), ("joint_1", "Both have: contact")),
        (("SOFT", "--other-model", "magic"), ("magic", "kelvin_voigt")),
        (("SOFT", "SWING"), ("share no channel", "contact", "joint")),
    ],
)
def test_incomparable_measurements_are_refused(arguments, words, soft, stiff, tmp_path):
    t = np.arange(0, 8, 0.02)
    swing = write_table(tmp_path / "swing.csv", time_s=t, position_rad=np.sin(3 * t), torque_Nm=np.cos(t))
    files = {"SOFT": soft, "STIFF": stiff, "SWING": swing}
    assert_refused(run("compare", *(files.get(one, one) for one in arguments)), *words)


def test_existing_file_is_not_replaced(soft, stiff, tmp_path):
    (tmp_path / "report.html").write_text("precious")
    assert_refused(run("compare", soft, stiff, "--out", tmp_path), "report.html: already exists")
    assert [one.name for one in tmp_path.iterdir()] == ["report.html"]
