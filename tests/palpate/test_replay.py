"""`palpate replay`: a session's motion repeated in simulation or with an arm."""

import json

import numpy as np
import pytest

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import Gains
from palpate.control.loop.task import Phase
from palpate.control.probing.replay import ReferenceTrajectory, ReplayTask
from palpate.estimation.study.paired_comparison import compare_pairs
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Session
from palpate.runs import probing, session
from palpate.runs.robots import find_robot
from palpate.study import Study
from tests.log_in_process import LogInProcess
from tests.palpate.cli import assert_refused, done, next_commands, run
from tests.palpate.sessions import QUICK, cut

pytestmark = pytest.mark.usefixtures("log_in_process")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A probing session of two quick runs."""
    path = tmp_path_factory.mktemp("recorded") / "default.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "SessionWriter", LogInProcess)
        quick = ("--experiment", QUICK, "--speed-mm-s", "150,100", "--online", "none")
        done("probe", "-o", path, "--seed", 5, *quick)
    return path


@pytest.fixture(scope="module")
def study(recorded):
    """A study of the probing, which fits once what several replays are held against."""
    return Study(recorded, keep=False)


def contact_of(first, second):
    grown = [[(one, ()) for one in study.channels if one.name == "contact"] for study in (first, second)]
    (found,) = compare_pairs(first, second, ("a", "b"), grown)
    return found


def test_replay_in_the_same_world_repeats_motion_and_force(recorded, study, tmp_path):
    twin = tmp_path / "twin.mcap"
    result = done("replay", recorded, "-o", twin, "--seed", 6)
    assert ["compare", str(recorded), str(twin)] in next_commands(result)
    found = contact_of(study, Study(twin, keep=False))
    assert found.agreement_percent > 95.0
    assert not any(one.differs for one in found.differences if one.name.startswith("stiffness"))
    ticks = [Session.open(path).samples("tick") for path in (recorded, twin)]
    last = [one["tip_position_world_m"][one["run"] == 1] for one in ticks]
    np.testing.assert_allclose(last[1][0], last[0][0], atol=1e-3)
    np.testing.assert_allclose(last[1].min(axis=0), last[0].min(axis=0), atol=1e-3)
    assert "default.mcap" in Session.open(twin).metadata.extra["replay_of"]


def test_replay_in_another_world_shows_its_object_and_names_the_session(recorded, study, tmp_path):
    world, twin = tmp_path / "softer.yaml", tmp_path / "twin.mcap"
    world.write_text("object: {law: {name: kelvin_voigt, stiffness_n_m: 300, damping_n_s_m: 20}}\n")
    told = done("replay", recorded, "-o", twin, "--scenario", world, "--json")
    names = {"session": str(twin), "replay_of": str(recorded)}
    assert json.loads(told.stdout) == names | {"outcome": "finished", "cause": "", "sealed": None}
    found = {one.name: one for one in contact_of(study, Study(twin, keep=False)).differences}
    assert found["stiffness.k"].second.value == pytest.approx(300.0, rel=0.01)
    assert found["stiffness.k"].value == pytest.approx(-200.0, rel=0.02)
    assert found["stiffness.k"].differs


def test_real_arm_gets_no_power_without_a_question(recorded, tmp_path, monkeypatch):
    monkeypatch.setattr(probing, "_check_arm", lambda *_: None)  # as if this arm had made the session
    result = run("replay", recorded, "--robot", "robots/dynamixel_3dof.yaml", "-o", tmp_path / "t.mcap")
    assert_refused(result, "a person must confirm before a real arm gets power", "--yes")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--robot", "leader"), ("a different arm", "--robot")),
        (("-o", "SESSION"), ("is the input",)),
        (("--scenario", "none.yaml"), ("none.yaml",)),
    ],
)
def test_unrepeatable_session_is_refused(recorded, tmp_path, options, words):
    given = [recorded if one == "SESSION" else one for one in options]
    out = [] if "-o" in options else ["-o", tmp_path / "t.mcap"]
    assert_refused(run("replay", recorded, *given, *out), *words)
    assert list(tmp_path.iterdir()) == []


def test_imported_session_has_no_arm_motion(hardening, tmp_path):
    assert run("import", hardening, "-o", tmp_path / "x.mcap").exit_code == 0
    assert_refused(
        run("replay", tmp_path / "x.mcap", "-o", tmp_path / "t.mcap"), "was not recorded with an arm"
    )


def test_truncated_session_is_repeated_to_the_last_rest(recorded, tmp_path):
    whole = probing.references_of(Session.open(recorded))
    part = probing.references_of(Session.open(cut(recorded, tmp_path / "part.mcap", 0.7)))
    for one in (whole, part):
        assert one.run[-1] == -1
        assert np.abs(one.velocity_rad_s[-1]).max() < 1e-3
    assert set(part.run) < set(whole.run)
    assert 0 in part.run
    short = cut(recorded, tmp_path / "short.mcap", 0.1)
    assert_refused(run("replay", short, "-o", tmp_path / "t.mcap"), "no complete run")


def references(**changes):
    n = 5
    known = {
        "time_s": np.arange(n) * 0.1,
        "position_rad": np.zeros((n, 3)),
        "velocity_rad_s": np.zeros((n, 3)),
        "run": np.zeros(n, dtype=int),
        "phase": np.full(n, int(Phase.APPROACH)),
        "press_direction_world": np.tile([0.0, 0.0, -1.0], (n, 1)),
    }
    return ReferenceTrajectory(**known | changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"time_s": np.zeros(5)}, "times do not increase"),
        ({"position_rad": np.full((5, 3), np.nan)}, "position_rad"),
        ({"phase": np.full(5, 99)}, "phase"),
    ],
)
def test_invalid_references_are_refused(changes, words):
    with pytest.raises(InputError, match=words):
        references(**changes)


def test_references_of_another_arm_are_refused():
    robot = find_robot("follower")
    body = RigidBody.from_urdf(robot.urdf_path, robot.tip_frame)
    with pytest.raises(InputError, match="2 joints, but the arm has 3"):
        ReplayTask(body, Gains(), references(position_rad=np.zeros((5, 2)), velocity_rad_s=np.zeros((5, 2))))
