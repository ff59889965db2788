"""`palpate probe` on the simulated arm."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from palpate.commands import demo
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.loop.result import LoopResult, Outcome
from palpate.control.loop.task import Phase
from palpate.estimation.data.channels import session_channels
from palpate.robot_io.files.file_model import parse_yaml
from palpate.robot_io.robot_file import parse_robot_file
from palpate.robot_io.session import Session
from palpate.runs.probing import PLAN, ProbingJob, ProbingOutcome, Watcher, run_probing
from palpate.runs.robots import find_robot
from palpate.sim_backend.scenario import MOST_SEED, Scenario
from tests.mock_robot import write_mock_files
from tests.palpate.cli import ROOT, assert_refused, done, run
from tests.palpate.sessions import QUICK, QUICK_RUN


def test_probe_reports_its_end_and_the_session_is_self_contained(probed):
    path, said = probed
    assert said["session"] == str(path)
    assert (said["outcome"], said["failed_runs"], said["dropped"]) == ("finished", [], 0)
    assert said["ticks"] == pytest.approx(1000 * said["duration_s"], rel=0.01)
    session = Session.open(probed[0])
    metadata = session.metadata
    assert parse_robot_file(metadata.robot_file, "session").name == "follower"
    assert Scenario.load(parse_yaml(metadata.scenario, "session")).seed == metadata.seed == 5
    assert "<robot" in metadata.urdf
    assert "speeds_m_s" in metadata.extra[PLAN]
    assert metadata.created_utc.endswith("+00:00")
    assert not session.truncated
    assert {"touch", "loop_ended"} <= {event.kind for event in session.events}
    ticks = session.samples("tick")
    assert np.isnan(ticks["stiffness_n_m"][0])
    assert ticks["stiffness_n_m"][-1] == pytest.approx(500, rel=0.01)
    assert ticks["damping_n_s_m"][-1] == pytest.approx(20, rel=0.05)
    assert ticks["surface_m"][-1] == pytest.approx(-0.05, abs=1e-4)


def test_probe_uses_the_requested_speeds_and_force(tmp_path, log_in_process):
    path = tmp_path / "two.mcap"
    plan = ("--experiment", QUICK, "--speed-mm-s", "150,75", "--force-limit-n", 5, "--repeats", 2)
    done("probe", "-o", path, *plan, "--online", "none")
    ticks = Session.open(path).samples("tick")
    assert np.unique(ticks["run"]).tolist() == [-1, 0, 1, 2, 3]
    assert 4.7 < np.nanmax(ticks["force_n"]) < 5.5
    approach = ticks["phase"] == 2
    for number, speed in ((0, 0.15), (1, 0.075), (2, 0.15), (3, 0.075)):
        rows = approach & (ticks["run"] == number)
        assert np.median(-ticks["tip_velocity_world_m_s"][rows, 2]) == pytest.approx(speed, rel=0.02)


def test_measured_torques_follow_the_commands_and_the_rigid_body_model(probed):
    """Figure 3a of the paper: the drives obey, and give what the rigid body needs, in contact too."""
    session = Session.open(probed[0])
    ticks = session.samples("tick")
    obeyed = ticks["torque_measured_nm"][1:] - ticks["torque_sent_nm"][:-1]  # sampled before the tick's own
    assert np.sqrt(np.mean(obeyed**2, axis=0)) == pytest.approx([0.01] * 3, rel=0.1)  # the sensor's noise

    joints = [channel for channel in session_channels(session) if channel.name.startswith("joint")]
    body, context = RigidBody.from_urdf(session.metadata.urdf, "tip"), joints[0].context
    motion = zip(
        *(context[f"joint_{what}"] for what in ("position", "velocity", "acceleration")), strict=True
    )
    push = context["contact_force"][:, None] * context["press_direction_world"]
    needed = [
        body.inverse_dynamics(q, v, a) + body.tip_jacobian(q)[:3].T @ f
        for (q, v, a), f in zip(motion, push, strict=True)
    ]
    unexplained = np.array([joint.effort for joint in joints]).T - needed
    for phase in (Phase.FREE_AIR, Phase.APPROACH, Phase.LOADING, Phase.HOLD):
        rows = joints[0].phase == phase
        assert np.abs(unexplained[rows].mean(axis=0)).max() < 0.02  # of up to 7 N m
    spread = np.std(unexplained[joints[0].phase != Phase.MOVE], axis=0)
    assert np.all(spread < [0.09, 0.04, 0.012])  # accelerations add to the 0.01 N m of the torque's noise


def test_user_robot_is_probed_in_real_time(tmp_path, monkeypatch):
    monkeypatch.setattr("palpate.runs.options.COUNTDOWN_S", 0)
    robot, path = write_mock_files(tmp_path), tmp_path / "own.mcap"
    patient = robot.read_text().replace("_age_s: 0.005", "_age_s: 1.0")  # a busy machine is no failure
    robot.write_text(patient)
    options = (
        *("--robot", robot, "--drivers", "tests.mock_robot"),
        *("--speed-mm-s", 120, "--hold-s", 0.1, "--json", "--yes"),
    )
    assert json.loads(done("probe", "-o", path, *options).stdout)["wall_s"] > 1.0
    session = Session.open(path)
    assert session.metadata.extra["source"] == "measured"
    assert (session.metadata.scenario, session.metadata.seed) == ("", None)
    assert session.samples("tick")["stiffness_n_m"][-1] == pytest.approx(1000, rel=0.1)
    assert_refused(run("probe", "-o", tmp_path / "x.mcap", *options, "--seed", 1), "not simulated")
    assert_refused(run("probe", "-o", tmp_path / "x.mcap", "--drivers", "no.such"), "--drivers", "no.such")


def write_deep(folder):
    """A world whose object is out of reach."""
    (folder / "deep.yaml").write_text("object: {surface_height_m: -0.5}\n")
    return folder / "deep.yaml"


def test_missing_object_is_reported(tmp_path, log_in_process):
    deep = write_deep(tmp_path)
    plan = tmp_path / "short.yaml"
    plan.write_text(f"{QUICK.read_text()}search_depth_m: 0.05\n")
    options = ("--scenario", deep, "--experiment", plan)
    shown = run("probe", "-o", tmp_path / "shown.mcap", *options)
    assert (shown.exit_code, "1 run planned, 1 failure" in shown.stdout) == (1, True)
    result = run("probe", "-o", tmp_path / "x.mcap", *options, "--json")
    said = json.loads(result.stdout)
    assert len(said["failed_runs"]) == 1
    assert "no touch" in said["failed_runs"][0]
    assert result.exit_code == 1  # a program that goes on with the session must know
    assert "1 failure while probing: run 0: no touch" in result.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--robot", "nobody"), ("nobody", "follower", "leader")),
        (("--scenario", "nowhere"), ("nowhere", "default", "stiff")),
        (("--speed-mm-s", "fast"), ("--speed-mm-s", "fast")),
        (("--speed-mm-s", "1e9"), ("--speed-mm-s", "give finite numbers between -1000000 and 1000000")),
        (("--speed-mm-s", "nan"), ("--speed-mm-s 'nan'", "give finite numbers between -1000000 and 1000000")),
        (("--speed-mm-s", "0"), ("--speed-mm-s",)),
        (("--speed-mm-s", "-20,30"), ("--speed-mm-s",)),
        (("--force-limit-n", "-1"), ("input should be greater than or equal to 0.01 (is -1",)),
        (("--force-limit-n", "much"), ("--force-limit-n", "number")),
        (("--repeats", "0"), ("--repeats: input should be", "(is 0)")),
        (("--seed", "-3"), ("--seed",)),
        (("--seed", str(10**18)), ("--seed", str(MOST_SEED))),
        (("--online", "ransac"), ("ransac", "rls", "none")),
        (("--experiment", "no_such.yaml"), ("no_such.yaml", "no such file")),
    ],
)
def test_bad_options_are_refused_before_anything_moves(tmp_path, options, words):
    path = tmp_path / "x.mcap"
    assert_refused(run("probe", "-o", path, *options), *words)
    assert not path.exists()


def test_unwritable_place_is_refused(tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert_refused(run("probe", "-o", tmp_path / "file" / "x.mcap"), "file")
    assert_refused(run("probe", "-o", tmp_path), "is a directory")


def test_ctrl_c_stops_the_arm_keeps_the_session_and_leaves_stdout_to_json(tmp_path):
    path = tmp_path / "broken_off.mcap"
    command = [sys.executable, "-m", "palpate.main", "probe", "-o", str(path), "--realtime", "--json"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        deadline_s = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < deadline_s:
            if path.exists() and path.stat().st_size > 80_000:  # some ticks have reached the disk
                break
            time.sleep(0.05)
        for _ in range(2):  # as a terminal does: to every process of the program, the log's writer as well
            os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    assert json.loads(said)["outcome"] == "stopped"
    session = Session.open(path)
    assert not session.truncated
    ticks = session.samples("tick")
    assert ticks["guard_tripped"][-1]
    assert ticks["phase"][-1] == Phase.STOPPED
    np.testing.assert_array_equal(ticks["torque_sent_nm"][-1], 0.0)
    assert run("inspect", path, "--save", tmp_path / "x.rrd").exit_code == 0


@pytest.mark.parametrize(("phase", "touched"), [(Phase.APPROACH, False), (Phase.HOLD, True)])
def test_stopped_run_states_whether_contact_occurred(tmp_path, log_in_process, phase, touched):
    class Stopper(Watcher):
        def observe(self, measurement, output):
            if output.phase is phase:
                signal.raise_signal(signal.SIGINT)
            return super().observe(measurement, output)

    job = ProbingJob(find_robot("follower"), tmp_path / "s.mcap", QUICK_RUN, online=None)
    outcome = run_probing(job, Stopper())
    assert str(outcome.loop.outcome) == "stopped"
    assert outcome.touched is touched


PLANS = {
    "targets_world_m: [[4, 0, 0.05]]": "out of reach",
    "search_depth_m: 1.0e-6": "search_depth_m 1e-06 m is too short",
    "force_limit_n: 60": "(limits.force_n); use at most 54.5 N",
    "hold_s: 1.0e+7": "plan fewer runs",
    "speeds_m_s: [1.0e-9]": "plan fewer runs",
    "repeats: true": "repeats",
}


@pytest.mark.parametrize(("plan", "words"), PLANS.items())
def test_infeasible_plan_is_refused_and_leaves_nothing(tmp_path, plan, words):
    (tmp_path / "plan.yaml").write_text(plan + "\n")
    out = tmp_path / "out" / "x.mcap"
    assert_refused(
        run("probe", "--experiment", tmp_path / "plan.yaml", "-o", out, "--hidden", "random"), words
    )
    assert not out.parent.exists() or not list(out.parent.iterdir())


def test_largest_seed_is_read_back():
    scenario = Scenario().with_seed(MOST_SEED)
    assert Scenario.load(parse_yaml(scenario.to_yaml(), "session")).seed == MOST_SEED


def test_demo_without_contact_is_reported(tmp_path, monkeypatch):
    lost = ProbingOutcome(tmp_path / "x.mcap", LoopResult(Outcome.FINISHED), ("run 0: no touch",))
    monkeypatch.setattr(demo, "run_probing", lambda job, watcher: lost)
    result = run("demo", "-o", tmp_path / "x.mcap")
    assert result.exit_code == 1
    assert "no touch" in result.stderr


def test_arm_without_masses_is_refused_before_anything_moves(tmp_path):
    shipped = find_robot("follower")
    light = re.sub(r"<inertial>.*?</inertial>", "", shipped.urdf_path.read_text(), flags=re.DOTALL)
    (tmp_path / "arm.urdf").write_text(light)
    text = re.sub("^urdf: .*$", "urdf: arm.urdf", shipped.text, flags=re.MULTILINE)
    (tmp_path / "arm.yaml").write_text(re.sub("^dh: .*$", "", text, flags=re.MULTILINE))
    out = tmp_path / "x.mcap"
    refused = run("probe", "--robot", tmp_path / "arm.yaml", "-o", out)
    assert_refused(refused, "joint 'shoulder' moves no mass")
    assert not out.exists()


def test_dh_table_of_another_arm_is_refused_before_anything_moves(tmp_path):
    shutil.copytree(find_robot("follower").path.parent, tmp_path / "arm")
    table = tmp_path / "arm" / "follower.dh.yaml"
    table.write_text(table.read_text().replace("a_m: 0.25", "a_m: 0.26"))
    out = tmp_path / "x.mcap"
    assert_refused(run("probe", "--robot", tmp_path / "arm" / "follower.yaml", "-o", out), "10 mm from")
    assert not out.exists()
