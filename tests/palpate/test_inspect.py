"""`palpate inspect` and `palpate demo`: outputs and refusals."""

import json
import os
import re
import resource
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from palpate.commands import demo
from palpate.doctor.machine import has_vulkan_driver
from palpate.render.inspection import inspect_session
from palpate.render.recording import file as rerun_file
from palpate.robot_io.errors import PalpateError
from palpate.robot_io.session import Session, write_session
from tests.palpate.cli import as_json, done, run, run_process
from tests.palpate.sessions import synthetic_session

pytestmark = pytest.mark.slow


def entities(path):
    return {chunk.entity_path for chunk in RrdReader(path).stream().to_chunks()}


def test_session_becomes_a_recording_of_everything(probed, tmp_path):
    recording = tmp_path / "seen.rrd"
    assert run("inspect", probed[0], "--save", recording).exit_code == 0
    assert {
        *("/contact/force", "/contact/displacement", "/phase", "/torque/joint_1", "/torque/joint_3"),
        *("/estimate/stiffness/online", "/estimate/stiffness/afterwards", "/estimate/damping/truth"),
        *("/object", "/tip", "/events", "/summary", "/timing/sections"),
    } <= entities(recording)


def test_default_output_is_beside_the_session(probed, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    result = run("inspect", probed[0])
    recording = Session.open(probed[0]).derived_dir / "recording.rrd"
    assert recording.is_file()
    assert f"rerun {recording}" in result.stderr


def test_plots_are_saved_in_the_requested_folder(probed, tmp_path):
    plots = tmp_path / "plots"
    assert run("inspect", probed[0], "--save", tmp_path / "x.rrd", "--plots", plots).exit_code == 0
    (file,) = plots.iterdir()
    page = re.sub("</?b>", "", file.read_text().rpartition("</head>")[2])
    for words in ("kelvin_voigt", "surface at", "contact force [N]", "joint_3: measured and sent"):
        assert words in page


def test_page_warns_like_estimate_where_the_model_does_not_describe_the_data(probed, tmp_path):
    whole = Session.open(probed[0])
    ticks = whole.samples("tick")
    columns = {name: ticks[name] for name in ticks}
    columns["force_n"] = ticks["force_n"] * (1.0 + 0.1 * ticks["force_n"])  # stiffens
    path = write_session(tmp_path / "stiffens.mcap", [(ticks.stream, columns)], whole.metadata)
    inspection = inspect_session(Session.open(path))
    remarks = inspection.view.channels[0].verdict.remarks
    (warning,) = (text for text in remarks if "not describe these data" in text)
    assert "The intervals do not include this model error" in warning
    assert warning in inspection.scene.summary
    shown = done("estimate", path, "--estimator", "robust,weighted,lsq").stdout
    assert warning in " ".join(shown.split())
    page = inspection.plot(tmp_path).read_text()
    assert 'class="verdict misses"' in page
    assert 'class="verdict fits"' not in page
    assert "correlated noise, but not for the model" in page
    assert inspect_session(whole).view.channels[0].verdict.word == "fits"


def test_session_of_another_arm_with_a_torn_end_is_shown(tmp_path):
    whole = synthetic_session(tmp_path / "whole.mcap")
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert run("inspect", torn, "--save", tmp_path / "torn.rrd").exit_code == 0
    assert "/contact/force" in entities(tmp_path / "torn.rrd")


@pytest.mark.skipif(not has_vulkan_driver(), reason="no Vulkan driver: Rerun cannot draw")
def test_picture_is_taken_without_a_display(probed, tmp_path, monkeypatch):
    monkeypatch.setattr(rerun_file, "_TOAST_S", 0.0)
    picture = tmp_path / "view.png"
    done("inspect", probed[0], "--save", tmp_path / "x.rrd", "--screenshot", picture)
    pixels = np.asarray(Image.open(picture).convert("RGB"))
    assert pixels.shape == (1000, 1600, 3)
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 500


def test_demo_makes_everything_at_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = as_json("demo", "--scenario", "engine")
    assert (tmp_path / made["session"]).is_file()
    assert (tmp_path / made["recording"]).is_file()
    assert [Path(plot).name for plot in made["plots"]] == ["plots.html"]
    assert (tmp_path / made["plots"][0]).is_file()
    best = next(e for e in made["result"]["estimates"] if e["estimator"] == "robust")
    assert abs(best["parameters"]["stiffness.k"]["error_percent"]) < 2.0
    assert made["hidden"] is None  # the engine's own contact cannot hide anything
    assert made["again"] == "palpate demo --scenario engine"  # and nothing was drawn by chance


def test_demo_without_a_seed_prints_the_command_to_repeat_it(tmp_path, monkeypatch):
    jobs = []
    done = SimpleNamespace(raise_for_failure=lambda: None)
    monkeypatch.setattr(demo, "run_probing", lambda job, watcher: jobs.append(job) or done)
    study = SimpleNamespace(truth_of=lambda channel: {})
    shown = (study, SimpleNamespace(channel=None), None, "plots.html")
    monkeypatch.setattr(demo, "show_demo", lambda session: shown)
    monkeypatch.setattr(demo, "solve", lambda session, progress: None)
    monkeypatch.setattr(demo, "as_data", lambda estimates, truth: {})
    again = json.loads(run("demo", "--json", "-o", tmp_path / "a.mcap").stdout)["again"]
    assert run(*again.split()[1:], "--json", "-o", tmp_path / "a.mcap").exit_code == 0
    plain, hidden, *repeated = [(job.scenario, job.seed, job.command_line) for job in jobs]
    assert repeated == [plain, hidden]
    assert hidden[0].hidden
    assert again == f"palpate demo --seed {hidden[1]}" == hidden[2]  # which the session keeps


def test_demo_finds_its_hidden_effect_and_reports_it(tmp_path):
    result = done("demo", "-o", tmp_path / "d.mcap", "--seed", 1)
    for words in ("truth", "500", "robust", "recording.rrd", "plots.html"):
        assert words in result.stdout
    assert "palpate inspect" in result.stderr
    _, _, second = result.stdout.partition("MISSING  contact")
    assert second.index("noise level") < second.index("CORRECT  the hidden effect was")
    assert "not found" not in second
    folder = tmp_path / "d-hidden"
    found = json.loads((folder / "diagnosis.json").read_text())["channels"][0]
    assert found["final"]["rmse"] < 1.05 * found["noise_floor"]
    for file in ("report.html", "revisions.rrd", "revisions/0001.json"):
        assert (folder / file).is_file()


def test_recording_on_a_full_disk_is_refused_without_a_partial_file(probed, tmp_path):
    def small():  # no file may grow beyond this: to a program it is a disk that is full
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))

    out = tmp_path / "x.rrd"
    result = run_process("inspect", probed[0], "--save", out, preexec_fn=small)
    assert result.returncode == 3, result.stderr
    assert f"palpate: cannot write {out}: " in result.stderr
    assert not list(tmp_path.iterdir())


class HalfAPicture:
    """A viewer that writes the beginning of its picture, and perhaps breaks off there."""

    def __init__(self, failure):
        self.failure = failure

    def open(self, recording):
        recording.encode()  # it takes no name but UTF-8

    def get_state(self):
        return SimpleNamespace(active_recording="x", loading=False)

    def set_time(self, *_timeline, **_moment):
        pass

    def save_screenshot(self, path):
        Path(path.encode().decode()).write_bytes(b"half")
        if self.failure:
            raise self.failure


@pytest.mark.parametrize("failure", [None, RuntimeError("the viewer is gone")])
def test_picture_of_the_viewer_is_written_atomically(tmp_path, monkeypatch, failure):
    monkeypatch.setattr(rerun_file, "_headless_viewer", lambda _size: nullcontext(HalfAPicture(failure)))
    monkeypatch.setattr(rerun_file, "_SETTLE_S", 0.0)
    monkeypatch.setattr(rerun_file, "_TOAST_S", 0.0)
    picture = tmp_path / os.fsdecode(b"\xff.png")
    picture.write_bytes(b"before")
    with pytest.raises(PalpateError, match="the viewer is gone") if failure else nullcontext():
        rerun_file.capture_screenshot(tmp_path / os.fsdecode(b"\xff.rrd"), picture, 0.0, (800, 600))
    assert list(tmp_path.iterdir()) == [picture]
    assert picture.read_bytes() == (b"before" if failure else b"half")
