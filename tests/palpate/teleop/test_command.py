"""`palpate teleop`: invalid input is refused in one line before anything moves."""

import pytest

from palpate.runs.robots import find_robot
from palpate.teleop.leader import LeaderOutcome
from tests.palpate.cli import assert_refused, run


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
    ("text", "words"),
    [
        *((text, ["operator.yaml"]) for text in ("device: nosuch", "path: []", "device: scripted")),
        *((text, ["operator.yaml"]) for text in ("- scripted", "device: [mouse]")),
        (  # an arm in the operator's hand gets no power without permission
            f"device: leader_arm\nrobot: {find_robot('follower').path}\n",
            ["a person must confirm before a real arm gets power", "--yes"],
        ),
    ],
)
def test_incomplete_or_unconfirmed_operator_is_refused(text, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "operator.yaml"
    path.write_text(text)
    assert_refused(run("teleop", "leader", "--operator", path), *words)
    assert not list(tmp_path.glob("**/*.mcap"))


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_leader_without_a_peer_fails_whatever_it_prints(options, tmp_path, monkeypatch):
    silence = LeaderOutcome({}, 0, heard=False, lateness=None)
    monkeypatch.setattr("palpate.commands.teleop.run_leader", lambda *_: silence)
    result = run("teleop", "leader", "--operator", "mouse", "-o", tmp_path / "leader.mcap", *options)
    assert result.exit_code == 1
    assert ('"heard": false' in result.output) is bool(options)
    assert "palpate: no follower answered: nothing was probed" in result.stderr


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_leader_whose_follower_left_targets_fails_and_names_them(options, tmp_path, monkeypatch):
    left = LeaderOutcome({0: "done", 1: "queued"}, 3, heard=True, lateness=None, unfinished=(1,))
    monkeypatch.setattr("palpate.commands.teleop.run_leader", lambda *_: left)
    result = run("teleop", "leader", "--operator", "mouse", "-o", tmp_path / "leader.mcap", *options)
    assert result.exit_code == 1
    assert "the follower did not finish target 1: it ended, fell silent or took too long" in result.stderr
    assert ("target 0: done, target 1: queued; 3 estimates received" in result.stdout) is not bool(options)
