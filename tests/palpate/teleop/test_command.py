"""`palpate teleop`: invalid input is refused in one line before anything moves."""

import pytest

from palpate.runs.robots import find_robot
from palpate.teleop.leader import LeaderOutcome
from tests.palpate.cli import assert_refused, done, run


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("leader", "--operator", "nosuch"), "no such device or file"),
        (("leader", "--operator", "mouse", "--link", "nosuch.json5"), "nosuch.json5"),
        (("leader", "--operator", "mouse", "--robot", "nosuch"), "no such robot file"),
        (("leader", "--operator", "mouse", "--scenario", "nosuch"), "no scenario"),
        (("leader", "--operator", "mouse", "--name", "a/b"), "link name"),
        (("leader", "--operator", "mouse", "--jump-n", "nan"), "--jump-n nan"),
        (("leader", "--operator", "mouse", "--jump-n", "0"), "--jump-n 0"),
        (("follower", "--bad-network", "5"), "delay, jitter [ms] and loss [%]"),
        (("follower", "--bad-network", "5,5,200"), "loss 2.0"),
        (("follower", "--port", "80"), "port 80"),
        (("follower", "--key", "nosuch.key"), "nosuch.key"),
        (("leader", "--operator", "mouse", "--key", "."), "key"),
        (("follower", "--robot", "nosuch"), "no such robot file"),
        (("follower", "--on-silence", "jump"), "finish"),
        (("demo", "--out", "x", "--scenario", "nosuch"), "no scenario"),
        (("demo",), "--out"),
    ],
)
def test_bad_input_is_one_line(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(run("teleop", *arguments), words)
    assert not list(tmp_path.glob("**/*.mcap"))


@pytest.mark.parametrize(
    "text", ["device: nosuch", "path: []", "device: scripted", "- scripted", "device: [mouse]"]
)
def test_incomplete_operator_file_is_refused(text, tmp_path):
    path = tmp_path / "operator.yaml"
    path.write_text(text)
    assert_refused(run("teleop", "leader", "--operator", path), "operator.yaml")


def test_arm_in_the_operator_s_hand_gets_no_power_without_permission(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "operator.yaml"
    path.write_text(f"device: leader_arm\nrobot: {find_robot('follower').path}\n")
    assert_refused(run("teleop", "leader", "--operator", path), "which a person must confirm", "--yes")
    assert not list(tmp_path.glob("**/*.mcap"))


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_leader_without_a_peer_fails_whatever_it_prints(options, tmp_path, monkeypatch):
    silence = LeaderOutcome({}, 0, heard=False, lateness=None)
    monkeypatch.setattr("palpate.commands.teleop.run_leader", lambda *_: silence)
    result = run("teleop", "leader", "--operator", "mouse", "-o", tmp_path / "leader.mcap", *options)
    assert result.exit_code == 1
    assert ('"heard": false' in result.output) is bool(options)


def test_help_lists_all_three_commands():
    result = done("teleop")
    for name in ("leader", "follower", "demo"):
        assert name in result.output
