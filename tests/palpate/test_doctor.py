"""`palpate doctor` on this machine: findings and remedies."""

import json

import pytest

from palpate.doctor import machine
from palpate.doctor.machine import examine_all
from palpate.robot_io.examination import Level
from palpate.sim_backend.engines import default_engine
from tests.palpate.cli import run


def test_this_machine_can_run_palpate_and_findings_have_a_remedy():
    broken = [finding for finding in examine_all() if finding.level is Level.FAIL]
    assert not broken
    findings = json.loads(run("doctor", "--json").stdout)["findings"]
    assert {"python", "packages", default_engine(), "real time"} <= {f["subject"] for f in findings}
    assert all(finding["remedy"] for finding in findings if finding["level"] != "ok")


def test_failing_check_is_a_finding_with_exit_code_1(monkeypatch):
    def broken_check():
        raise RuntimeError("engine [x86] gone")
        yield

    monkeypatch.setattr(machine, "CHECKS", (broken_check, machine.memory_lock))
    result = run("doctor")
    assert result.exit_code == 1
    assert "engine [x86] gone" in result.stdout  # as it is, and not as markup
    assert "memory lock" in result.stdout


def test_missing_system_library_is_named_with_its_package(monkeypatch):
    def no_openmp():
        raise ImportError("libgomp.so.1: cannot open shared object file: No such file or directory")
        yield

    monkeypatch.setattr(machine, "CHECKS", (no_openmp,))
    (finding,) = examine_all()
    assert finding.level is Level.FAIL
    assert "libgomp.so.1" in finding.text
    assert "apt install libgomp1" in finding.remedy


def test_missing_package_is_a_failure(monkeypatch):
    monkeypatch.setattr(machine.metadata, "requires", lambda _: ["numpy", "surely-not-installed>=1"])
    (finding,) = machine.packages()
    assert finding.level is Level.FAIL
    assert "surely-not-installed" in finding.text
    assert "numpy" not in finding.text


def test_untested_version_is_a_warning(monkeypatch, tmp_path):
    constraints = tmp_path / "constraints.txt"
    constraints.write_text("# tested versions\nnumpy==0.0.1\n")
    monkeypatch.setattr(machine, "CONSTRAINTS", constraints)
    (finding,) = machine.packages()
    assert finding.level is Level.WARN
    assert "0.0.1" in finding.text


@pytest.mark.parametrize(
    ("display", "driver", "level"), [("", True, "ok"), ("", False, "warn"), (":0", False, "ok")]
)
def test_pictures_need_a_display_or_a_driver(monkeypatch, display, driver, level):
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(machine, "has_vulkan_driver", lambda: driver)
    (finding,) = machine.rerun()
    assert finding.level.value == level
