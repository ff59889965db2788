"""`palpate diagnose`: the command, its warnings, and what later commands take from a diagnosis."""

import json
import os
import re

import numpy as np
import pytest

from palpate.estimation.study.saved_diagnosis import RESULT
from palpate.study import Study
from tests.estimation.arm.test_joint_models import arm
from tests.few_effects import try_few_effects
from tests.files import saved, write_csv
from tests.palpate.cli import ROOT, as_json, assert_refused, done, next_commands, run
from tests.palpate.presses import CUBIC, press_columns, write_own_effect, write_presses, write_table

# What needs the whole library is made before: a module's fixture.
pytestmark = pytest.mark.usefixtures("few_effects", "without_figures")
FOLLOWER = ROOT / "sim_backend" / "arms" / "follower" / "follower.urdf"
KEYS = {
    *("channel", "verdict", "reason", "noise_floor", "baseline", "accepted", "ranking", "final"),
    *("depends_on", "next_experiment", "no_experiment"),
}


@pytest.fixture(scope="module")
def applied(hardening, tmp_path_factory):
    """What `diagnose --apply` printed, and where it wrote."""
    folder = tmp_path_factory.mktemp("applied")
    return run("diagnose", hardening, "--apply", "--out", folder), folder


def test_hidden_cubic_stiffness_is_identified_with_its_value(applied):
    result, folder = applied
    assert result.exit_code == 0, result.stderr
    found = json.loads((folder / "diagnosis.json").read_text())
    assert found["model"] == "kelvin_voigt"
    (channel,) = found["channels"]
    assert set(channel) >= KEYS
    assert channel["verdict"] == "missing"
    (accepted,) = channel["accepted"]
    assert accepted["effect"] == "cubic_stiffness"
    k3 = accepted["parameters"]["k3"]
    assert abs(k3["value"] - CUBIC) < 4 * k3["std_err"]
    assert accepted["rmse_after"] < accepted["rmse_before"] / 5


def test_fitted_masses_are_advised_if_a_link_is_heavier_than_its_urdf(tmp_path):
    """The second joint names no effect of its kinds, and the fitted masses leave only noise."""
    path, urdf = write_arm(tmp_path / "arm.csv"), tmp_path / "arm.urdf"
    for mass, is_advised in (("1.2", False), ("0.9", True)):
        urdf.write_text(FOLLOWER.read_text().replace('mass value="1.2"', f'mass value="{mass}"'))
        result = run("diagnose", path, "--urdf", urdf, "--channel", "joint_2")
        advised = [words for words in next_commands(result) if "rigid_body_fitted" in words]
        assert bool(advised) is is_advised, result.stderr
        assert not advised or "--channel" in advised[0]


def write_arm(path):
    """Swings of the simulated follower, with noise of 0.02 N m."""
    channels = arm(1)
    table = {"time_s": channels[0].time_s, "run": channels[0].run}
    for number, channel in enumerate(channels, 1):
        table |= {f"position_{number}_rad": channel.position, f"torque_{number}_Nm": channel.effort}
    return write_csv(path, table)


def test_budget_precedes_the_verdict_and_no_other_base_model_is_advised(applied):
    result, _ = applied
    assert re.match(r"contact  Of the [\d.]+ N error: elastic shape \d+ %, noise", result.stdout)
    (verdict,) = [line for line in result.stdout.splitlines() if line.startswith("MISSING")]
    assert verdict.startswith("MISSING  contact: cubic_stiffness")
    assert "is missing from" in verdict
    for words in ("(noise 0.02", "k3", "95 % interval", "F = k3 x^3"):
        assert words in result.stdout
    assert "Next" in result.stderr
    assert "palpate export" in result.stderr
    # A Hunt-Crossley model leaves less than half of a hardening object's error, and six times the noise.
    assert not [words for words in next_commands(applied[0]) if "--model" in words]


def test_proposed_comparison_keeps_the_model(hardening):
    result = run("diagnose", hardening, "--model", "kelvin_voigt")
    (compared,) = [words for words in next_commands(result) if words[0] == "compare"]
    assert compared[compared.index("--model") + 1] == "kelvin_voigt"


def test_applying_saves_each_step_and_plots_the_decrease(applied):
    _, folder = applied
    kept = [json.loads(file.read_text()) for file in sorted((folder / "revisions").iterdir())]
    assert [(r["number"], r["parent"], r["added"]) for r in kept] == [
        (0, None, ""),
        (1, 0, "cubic_stiffness"),
    ]
    assert kept[1]["rmse"] < kept[0]["rmse"] / 5
    for file in ("report.html", "revisions.rrd"):
        assert (folder / file).stat().st_size > 1000


def test_effects_of_the_newest_revision_are_not_suggested_again(applied, hardening):
    result = run("diagnose", hardening, "--out", applied[1], "--force")
    assert [words[0] for words in next_commands(result)] == ["revisions", "export", "compare"]


def test_advised_add_starts_fresh_where_revisions_have_other_effects(hardening, tmp_path):
    """`palpate add` continues the newest revision, while a diagnosis begins at the base model."""
    done("add", hardening, "quadratic_damping", "--out", tmp_path)
    result = run("diagnose", hardening, "--out", tmp_path, "--force")
    (added,) = [words for words in next_commands(result) if words[0] == "add"]
    assert added[-2:] == ["cubic_stiffness", "--fresh"]


def test_json_alone_is_on_stdout_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (channel,) = as_json("diagnose", write_presses(tmp_path / "plain.csv", cubic=0))["channels"]
    assert channel["verdict"] == "adequate"
    assert [path.name for path in tmp_path.iterdir()] == ["plain.csv"]


def test_insufficient_data_get_the_reason(tmp_path):
    one = write_presses(tmp_path / "one.csv", speeds_m_s=(0.02,))
    header, *rows = one.read_text().splitlines()
    one.write_text("\n".join([header, *rows[100:151]]) + "\n")
    result = done("diagnose", one)
    assert result.stdout.startswith("INSUFFICIENT  contact")
    assert "only 51 samples" in result.stdout
    assert "channel 'contact'" not in result.stdout  # the verdict gives the reason
    assert [words[0] for words in next_commands(result)] == ["import"]
    (words,) = next_commands(run("estimate", one))
    assert words[0] == "diagnose"


def test_more_files_are_requested_only_for_too_few_runs(tmp_path):
    still = write_presses(tmp_path / "still.csv")
    columns = press_columns(still)
    result = run("diagnose", write_table(still, **columns | {"force_N": columns["force_N"] * 0.0 + 1.0}))
    assert "the effort never changes" in result.stdout
    assert next_commands(result) == [["import", str(still), "--look"]]


def rewritten(path, name, values, change):
    """The file with one more column, a number for each run, and with rows changed by that."""
    columns = press_columns(path)
    each = np.array(values)[columns["run"].astype(int)]
    change(columns, each)
    return write_table(path, **columns, **{name: each})


def test_recorded_column_that_explains_the_error_is_named(tmp_path):
    def soften(columns, warmth):
        columns["force_N"] *= 1 - 0.02 * (warmth - 25)

    plain = write_presses(tmp_path / "warm.csv", cubic=0, speeds_m_s=(0.05, 0.06, 0.1, 0.07, 0.08, 0.09))
    warm = rewritten(plain, "warmth", [21.0, 29.0, 23.0, 27.0, 25.0, 22.0], soften)
    blamed = run("diagnose", warm, "--context", "warmth")
    assert blamed.stdout.startswith("contact  Of the 0.170 N error: recorded context 98 %")
    assert "\nMISSING  contact: recorded_dependence" in blamed.stdout
    assert "change_warmth" in blamed.stdout


def test_next_commands_name_their_joint(tmp_path, monkeypatch):
    try_few_effects(monkeypatch, few=("coulomb_friction",))
    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # diagnose both channels in this process
    run_number, t = np.repeat(np.arange(3), 100), np.tile(np.arange(100) * 0.03, 3)
    w = 2 * np.pi * (0.5 + 0.1 * run_number)
    q, v, a = np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)
    noise = np.random.default_rng(0).normal(0.0, 0.005, (2, len(t)))
    torques = 0.05 * a + noise + [[0.4], [0.6]] * np.tanh(v / 0.02)
    joints = {"position_1_rad": q, "torque_1_Nm": torques[0], "position_2_rad": q, "torque_2_Nm": torques[1]}
    data = write_table(tmp_path / "joints.csv", time_s=t, run=run_number, **joints)
    folder = tmp_path / "out"
    shown = done("diagnose", data, "--out", folder)
    added = [words for words in next_commands(shown) if words[0] == "add"]
    assert ["--channel", "joint_1"] in [words[-2:] for words in added]
    assert ["--channel", "joint_2"] in [words[-2:] for words in added]
    both = json.loads((folder / "diagnosis.json").read_text())
    (alone,) = as_json("diagnose", data, "--channel", "joint_2", "--out", folder, "--force")["channels"]
    assert alone["channel"] == "joint_2"
    # the verdict on the other channel stays in the file
    assert json.loads((folder / "diagnosis.json").read_text()) == both
    as_json("diagnose", data, "--channel", "joint_2", "--model", "pendulum", "--out", folder, "--force")
    mixed = json.loads((folder / "diagnosis.json").read_text())
    assert mixed["channels"][0] == both["channels"][0]
    assert mixed["model"] == "inertia+pendulum"
    assert [mixed["judged"][name]["model"] for name in ("joint_1", "joint_2")] == ["inertia", "pendulum"]
    assert [
        (result.channel.model.name, result.diagnosis is not None)
        for result in Study(data, folder=folder).results()
    ] == [("inertia", True), ("pendulum", True)]
    (folder / "diagnosis.json").write_text("{}")
    warned = done("diagnose", data, "--channel", "joint_2", "--out", folder, "--force")
    assert "verdicts on other channels could not be kept" in " ".join(warned.stderr.split())
    (only,) = json.loads((folder / "diagnosis.json").read_text())["channels"]
    assert only == alone


def test_model_does_not_fit_other_runs_that_are_stiffer(tmp_path):
    """The runs of the fit show no missing effect, but the held-out run is of another object."""
    columns = press_columns(write_presses(tmp_path / "press.csv", cubic=0))
    columns["force_N"][columns["run"] == 2] *= 1.6
    file = write_table(tmp_path / "other.csv", **columns)
    (channel,) = as_json("compare", file, "--held-out", 2)["channels"]
    assert channel["lack_of_fit"] > 10.0
    assert channel["fits"] is False


def test_user_effect_is_identified_by_its_name(tmp_path):
    """A law that palpate does not know: force proportional to depth times the sine of depth."""
    file = saved(tmp_path / "my_effects.py", OWN_EFFECT)
    law = lambda x, v: 400 * x + 6 * v + 0.4 * np.sin(1500 * x)  # noqa: E731
    data = write_presses(tmp_path / "wavy.csv", force_of=law)
    shown = done("diagnose", data, "--effect", f"{file}:Waves", "--out", tmp_path / "found")
    (channel,) = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["channels"]
    assert [entry["effect"] for entry in channel["accepted"]] == ["waves"]
    (added,) = [words for words in next_commands(shown) if words[0] == "add"]
    done(*added, "--json")
    assert f"--effect {file}:Waves" in (tmp_path / "found" / "report.html").read_text()


OWN_EFFECT = """
import numpy as np
from palpate.estimation.channel import ChannelKind
from palpate.estimation.effect import AdditiveEffect, Parameter

class Waves(AdditiveEffect):
    name = "waves"
    physics = "Ridges in the object."
    equation = "F = a sin(1500 x)"
    source = "this test"
    signature = "force goes up and down with depth"
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("a", "{effort}", -10.0, 10.0, (0.1, 1.0)),)

    def columns(self, data, inner):
        return np.where(data.engaged, np.sin(1500 * data.position), 0.0)[:, None]

class Nameless(AdditiveEffect):
    def columns(self, data, inner):
        return data.position[:, None]
"""


INVALID_BODIES = [
    ("def known(self, data): return np.zeros(len(data))", ("odd", "known() takes 2 positional")),
    ("def known(self, data, inner): return np.zeros(3)", ("odd", "known() returns an array of shape (3,)")),
    ("def columns(self, data, inner): return 1j * data.position[:, None]", ("complex128", "real number")),
    ("def columns(self, data, inner): return 'hello'", ("odd", "real numbers")),
    ("def is_misnamed(self, data, parameters): return 1", ("is_misnamed() takes 3 positional",)),
    ("def suited_to(self, data): return None", ("suited_to", "same name")),
    (
        "inner = (Parameter('t', 's', 0, 1, (0.1, 0.2)),); starts = lambda self, data: ({},)",
        ("starts() returns", "t"),
    ),
    ("def simpler(self, columns): raise KeyError('a')", ("odd", "KeyError")),
    ("name = 'bias'", ("'bias' is taken", "another name")),
    ("name = 7", ("mine.py:Odd", "its name is 7", "lower-case letters")),
    (r"name = '[red]x\x1b[2J'", ("mine.py:Odd", r"its name is '[red]x\x1b[2J'")),
    ("gains = 5", ("mine.py:Odd", "its gains are 5", "tuple of Parameter")),
    ("gains = (Parameter('a', 'N', '0', 1.0, (0.1, 1.0)),)", ("mine.py", "TypeError")),
    ("physics = None", ("mine.py:Odd", "physics is None")),
]
ODD = f"{OWN_EFFECT}\nclass Odd(Waves):\n    name = 'odd'\n    "


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        *(("FILE:Odd", f"{ODD}{body}\n", words) for body, words in INVALID_BODIES),
        ("none.py:X", "", ("none.py", "no such file")),
        ("FILE", OWN_EFFECT, ("FILE.py:Class",)),
        ("FILE:Missing", OWN_EFFECT, ("Missing", "Waves")),
        ("FILE:Nameless", OWN_EFFECT, ("does not state", "name")),
        ("FILE:X", "import a_module_that_is_not_there", ("mine.py", "a_module_that_is_not_there")),
        ("FILE:X", "import sys; sys.exit(0)", ("mine.py", "SystemExit")),
        (
            "FILE:X",
            "class End(BaseException): pass\nraise End('of the\\nworld')",
            ("mine.py", "End: of the world"),
        ),
    ],
)
def test_invalid_effect_is_refused_in_one_line(hardening, tmp_path, text, code, words):
    file = saved(tmp_path / "mine.py", code)
    assert_refused(run("diagnose", hardening, "--effect", text.replace("FILE", str(file))), *words)


def test_output_of_a_user_effect_is_separated_from_results(hardening, tmp_path):
    file = tmp_path / "mine.py"
    loud = "        print('from', 'columns')\n        return np.where"
    file.write_text(f"print('at import')\n{OWN_EFFECT.replace('        return np.where', loud)}")
    result = done("add", hardening, "waves", "--effect", f"{file}:Waves", "--out", tmp_path / "out", "--json")
    assert len(json.loads(result.stdout)["revisions"]) == 2
    assert "at import\n" in result.stderr
    assert "from columns\n" in result.stderr


def test_reason_for_no_named_effect_is_shown_and_reported(tmp_path):
    """Another specimen, with a law of its own: the reason is the runs, and no user would guess it.

    A column that nothing was made of is pointed out: it might be the reason.
    """

    def bend_the_last(columns, _):
        force, last = columns["force_N"], columns["run"] == 3
        force[last] = 2.0 * force[last].max() - force[last]

    presses = write_presses(tmp_path / "two.csv", cubic=0.0)
    specimen = rewritten(presses, "warmth", [21.0, 29.0, 23.0, 27.0], bend_the_last)
    result = run("diagnose", specimen, "--out", tmp_path / "out")
    assert "\nUNEXPLAINED  contact" in result.stdout
    told = " ".join(result.stdout.split())
    assert "the runs do not follow one law" in told
    assert "or a sensor? " in told  # one mark, not two
    assert "the runs do not follow one law" in (tmp_path / "out" / "report.html").read_text()
    assert "two.csv --context warmth" in result.stderr


def test_session_is_judged_in_the_named_channel(probed):
    path, _ = probed
    (contact,) = as_json("diagnose", path, "--channel", "contact")["channels"]
    assert (contact["channel"], contact["verdict"]) == ("contact", "adequate")
    assert_refused(
        run("diagnose", path, "--channel", "joint_9"), "joint_9", "contact, joint_1, joint_2, joint_3"
    )


def test_warnings_reach_the_diagnosis_file_and_the_terminal(tmp_path):
    file = write_presses(tmp_path / "presses.csv", cubic=0.0)
    columns = press_columns(file)
    depth = 50.0 * columns["displacement_m"]
    fast = 2.0 * np.gradient(depth, columns["time_s"])
    write_table(file, **columns | {"displacement_m": depth, "velocity_m_s": fast})
    result = done("diagnose", file, "--json", "--out", tmp_path / "out")
    (channel,) = json.loads(result.stdout)["channels"]
    assert channel["verdict"] == "adequate"
    words = "the deepest indentation is 0.5 m, more than 0.2 m"
    assert words in channel["warnings"][1]
    assert "is 2 times the rate of change" in channel["warnings"][0]
    assert words in " ".join(result.stderr.split())
    kept = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert kept["channels"][0]["warnings"] == channel["warnings"]
    assert words in (tmp_path / "out" / "report.html").read_text()


def test_identical_notes_of_two_files_are_shown_once(tmp_path):
    for seed, name in enumerate(("a.csv", "b.csv")):
        file = write_presses(tmp_path / name, seed=seed)
        file.write_text(file.read_text().replace("displacement_m,force_N", "Way [m],Load [N]", 1))
    assert done("compare", tmp_path / "a.csv", tmp_path / "b.csv").stderr.count("read: ") == 1


def words_of(page):
    """What a page says: without markup, and without the program that draws."""
    return re.sub("<[^>]*>", "", page.read_text().partition("<main>")[2])


@pytest.mark.slow
def test_report_after_adding_keeps_the_verdict_and_names_the_addition(tmp_path):
    data, folder = write_presses(tmp_path / "hard.csv"), tmp_path / "out"
    assert run("diagnose", data, "--out", folder).exit_code == 0
    found = json.loads((folder / RESULT).read_text())["channels"][0]
    added = done("add", data, "bias", "--out", folder, "--force", "--json")
    report = words_of(folder / "report.html")
    for words in (
        "MISSING",
        "cubic_stiffness is missing",
        "base model and one effect",
        "contact with bias: the error in held-out runs",
        f"palpate diagnose {data} --out {folder} --channel contact",
        "bias --fresh",
    ):
        assert words in report
    assert json.loads(added.stdout)["revisions"][0]["noise_floor"] == found["noise_floor"]


@pytest.mark.slow
def test_diagnosis_with_unavailable_user_effect_is_not_shown_without_it(tmp_path):
    """It was added by a command; the report of a study that was not given its file says so."""
    data, place, folder = write_presses(tmp_path / "hard.csv"), write_own_effect(tmp_path), tmp_path / "out"
    assert run("add", data, "mine", "--effect", place, "--out", folder).exit_code == 0
    (silent,), (whole,) = (Study(data, folder=folder, effects=given).results() for given in ((), [place]))
    assert (whole.added, whole.reason, silent.added) == (["mine"], "", [])
    for words in ("contact is shown without its added effects", f"add --effect {place}"):
        assert words in silent.reason
    page = Study(data, folder=folder).report(tmp_path / "silent.html")
    assert "contact is shown without its added effects" in words_of(page)


def test_report_without_a_diagnosis_tells_the_last_fit(tmp_path):
    data = write_presses(tmp_path / "hard.csv")
    assert run("add", data, "cubic_stiffness", "--out", tmp_path / "out").exit_code == 0
    report = words_of(tmp_path / "out" / "report.html")
    assert "kelvin_voigt + cubic_stiffness fits contact" in report
    data = write_presses(tmp_path / "hard.csv")
    (tmp_path / RESULT).write_text("{}")
    result = run("add", data, "bias", "--out", tmp_path, "--force")
    assert_refused(result, RESULT, "damaged", "palpate diagnose again")
