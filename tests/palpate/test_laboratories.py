"""Files of many laboratories, read without an option: imported, diagnosed, and their truth found."""

import json

import numpy as np
import pytest

from palpate.robot_io.errors import InputError
from palpate.study import Study, arm_from_urdf
from tests.estimation.laboratories import (
    LABORATORIES,
    joint_log,
    one_file_a_run,
    plain,
    presses,
    savetxt,
    zwick,
)
from tests.palpate.cli import ROOT, as_json, done, next_commands, run

FOLLOWER = ROOT / "sim_backend" / "arms" / "follower" / "follower.urdf"

IDS = [one.__name__ for one in LABORATORIES]
DIAGNOSED = {plain, savetxt, one_file_a_run, joint_log}  # the others hold the same presses as `plain`


@pytest.mark.parametrize(("write", "verdict", "truth"), [(w, *t) for w, t in LABORATORIES.items()], ids=IDS)
@pytest.mark.usefixtures("few_effects")
def test_a_file_is_diagnosed_or_compared_as_it_is(tmp_path, monkeypatch, write, verdict, truth):
    monkeypatch.chdir(tmp_path)
    (channel,) = as_json("diagnose" if write in DIAGNOSED else "compare", write(tmp_path))["channels"]
    if write in DIAGNOSED:
        assert channel["verdict"] == verdict, channel["reason"]
        found = {name: one["value"] for name, one in channel["final"]["parameters"].items()}
    else:
        found = channel["parameters"]
        assert channel["lack_of_fit"] < 1.1
    for name, (value, off) in truth.items():
        assert found[name] == pytest.approx(value, rel=off), name


@pytest.mark.parametrize("write", LABORATORIES, ids=IDS)
def test_what_was_taken_for_what_is_said(tmp_path, write):
    path = write(tmp_path)
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    result = done("import", *files, "-o", tmp_path / "session.mcap", "--json")
    (channel,) = json.loads(result.stdout)["channels"]
    assert channel["runs"] == (1 if channel["kind"] == "revolute" else 4)
    assert "read: " in result.stderr
    assert "time '" in result.stderr


def test_the_report_says_how_the_file_was_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("report", joint_log(tmp_path)).exit_code == 0
    page = (tmp_path / "report.html").read_text()
    assert "How the data were read" in page
    assert "1 A counts as 1 N m" in page


def test_a_look_shows_columns_runs_and_phases_and_stores_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = zwick(tmp_path)
    result = run("import", path, "--look", "--runs", "2")
    for words in ("3 lines above the header", "displacement in mm", "-1,00000", "contact: 2 runs", "hold"):
        assert words in result.stdout
    assert [*tmp_path.iterdir()] == [path]
    (words,) = next_commands(result)
    assert words[0] == "import"
    assert words[-2:] == ["--runs", "2"]
    assert run(*words).exit_code == 0
    assert (tmp_path / "sessions" / "Schaum 12.mcap").is_file()


def test_columns_that_are_the_same_in_each_file_of_a_folder_are_shown_once(tmp_path):
    result = run("import", one_file_a_run(tmp_path), "--look")
    assert result.stdout.count("displacement in mm") == 1
    assert result.stdout.count("contact: 1 run") == 4


def test_a_look_at_what_is_ambiguous_shows_the_columns_and_asks(tmp_path):
    path = tmp_path / "two.csv"
    path.write_text("Time [s],Way [mm],A [N],B [N]\n" + "".join(f"{i},{i},{i},{-i}\n" for i in range(30)))
    result = run("import", path, "--look")
    assert result.exit_code == 2
    assert "A [N]" in result.stdout
    assert "not used" not in result.stdout
    (line,) = result.stderr.splitlines()
    assert "--column force='A [N]'" in line


def test_relaxation_shows_in_the_hold(tmp_path):
    t, x, f = presses()
    relaxed = np.where(x > 0.0, f * (0.7 + 0.3 * np.exp(-np.maximum(x, 0.0) / 1e-3)), f)
    rows = zip(t, 1e3 * x, relaxed, strict=True)
    path = tmp_path / "soft.csv"
    path.write_text("Time (s),Travel (mm),Load (N)\n" + "".join(f"{a},{b},{c}\n" for a, b, c in rows))
    result = run("compare", path, "--json")
    (channel,) = json.loads(result.stdout)["channels"]
    assert {"hold", "loading", "unloading"} <= {part["label"] for part in channel["parts"]["phase"]}


def test_the_last_link_is_the_tip_where_none_is_called_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = FOLLOWER.read_text().replace('"tip"', '"finger"')
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(text)
    arm = arm_from_urdf(urdf)
    assert arm.tip_frame == "finger"
    assert "the last link, 'finger', is used" in arm.notes[0]
    assert arm_from_urdf(FOLLOWER).notes == ()
    assert arm_from_urdf(urdf, "hand").notes == ()
    with pytest.raises(InputError, match="no frame is called 'tip'"):
        arm_from_urdf(urdf, "tip")


@pytest.mark.parametrize("pulled", [True, False])
def test_a_mass_on_a_spring_is_what_is_pressed_or_pulled(pulled):
    t = np.arange(0.0, 8.0, 0.004)
    x = 3e-3 * np.sin(7.0 * t) + 1e-3 * np.sin(23.0 * t)
    v = 2.1e-2 * np.cos(7.0 * t) + 2.3e-2 * np.cos(23.0 * t)
    a = -0.147 * np.sin(7.0 * t) - 0.529 * np.sin(23.0 * t)
    force = 0.3 * a + 2.0 * v + 500.0 * x
    if not pulled:  # in free air only the mass is moved
        force = np.where(x > 0.0, force, 0.3 * a)
    force += np.random.default_rng(1).normal(0.0, 0.005, len(t))
    data = {"time_s": t, "displacement_m": x, "force_N": force}
    study = Study(data, model="spring_mass_damper", keep=False)
    fitted = study.fit("contact", ())
    truth = {"inertia.m": 0.3, "damping.c": 2.0, "stiffness.k": 500.0}
    assert fitted.values == pytest.approx(truth, rel=0.03)
    assert (fitted.data.touching is not None) == pulled
