"""`palpate doctor`: check this machine, and whether an arm matches its robot file."""

import sys
from collections.abc import Mapping
from itertools import chain
from typing import Annotated

import typer
from typer import Option

from palpate.common import console
from palpate.common.console import AT_REST, FIRST_PROBE, as_shell_word, count, safe
from palpate.common.options import JsonOption
from palpate.doctor.arm import NOT_POWERED, ArmCheck, examine_arm
from palpate.doctor.machine import examine_all, memory_lock, real_time
from palpate.robot_io.errors import InputError
from palpate.robot_io.examination import Finding, Level
from palpate.runs.robots import describe_wires, find_robot, importable, is_simulated, robot_names

MARKS = {
    Level.OK: "[green]ok[/green]",
    Level.WARN: "[yellow]warn[/yellow]",
    Level.SKIP: "[cyan]skip[/cyan]",
    Level.FAIL: "[bold red]fail[/bold red]",
}
QUESTION = (
    "Hands away from the arm. Power it now? Each joint moves by 3 degrees and back; then the "
    "torque is switched off and the arm sinks."
)
_SUBJECT_WIDTH = 20


_ROBOT = "Robot file of the arm to check before it gets power."
_AS_BUILT = "With --wire: emulate the devices that this robot file describes."
_MOVE = "Check the signs of joints and force: by hand, then, after a confirmation, under power."
_DRIVERS = "Python package with your own drivers."


def doctor_command(  # noqa: PLR0917, one parameter an option
    robot: Annotated[str | None, Option(help=_ROBOT, metavar="FILE", autocompletion=robot_names)] = None,
    wire: Annotated[bool, Option("--wire", help="Emulate the arm's devices, without any hardware.")] = False,
    as_built: Annotated[str | None, Option(help=_AS_BUILT, metavar="FILE")] = None,
    move: Annotated[bool, Option("--move", help=_MOVE)] = False,
    drivers: Annotated[list[str] | None, Option(help=_DRIVERS, metavar="PACKAGE")] = None,
    yes: Annotated[bool, Option("--yes", help="With --wire: do not ask before the arm gets power.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Check this machine, or with --robot the limits, ports, devices and rates of an arm.

    With --move, also check the signs of its joints and of its force. The exit code is 0 if no check fails,
    else 1. The arm gets no power without --move and a confirmation.
    """
    if robot is None:
        given = {"--wire": wire, "--as-built": as_built, "--move": move, "--yes": yes, "--drivers": drivers}
        _refuse(given, "add --robot FILE")
        check = None
        findings = list(examine_all())
        verdict = ("palpate works here", "palpate will not work here")
        if not as_json:
            table = console.table("", "", "subject", "finding")
            for finding in findings:
                remedy = f"\n[cyan]→ {safe(finding.remedy)}[/cyan]" if finding.remedy else ""
                table.add_row(MARKS[finding.level], finding.subject, safe(finding.text) + remedy)
            console.stdout().print(table)
    else:
        if not wire:
            _refuse({"--as-built": as_built}, "this option applies to emulated devices only; add --wire")
            _refuse({"--yes": yes}, "a real arm gets power only if somebody at the arm confirms")
        if move and not yes and not _has_terminal():
            remedy = "the devices are emulated, so add --yes" if wire else "run it in a terminal at the arm"
            raise InputError(f"--move needs a person to confirm; {remedy}")
        check = ArmCheck(
            find_robot(robot),
            wired=wire,
            as_built=find_robot(as_built) if as_built is not None else None,
            move=move,
            drivers=importable(drivers or []),
            may_power=lambda: yes or typer.confirm(QUESTION, err=True),
        )
        findings = _examine(check, quiet=as_json)
        name = safe(check.robot_file.name)
        well = "passes the checks that need no power" if NOT_POWERED in findings else "passes all checks"
        verdict = (f"'{name}' {well}", f"'{name}' must not get power in this state")
    failed = any(finding.level is Level.FAIL for finding in findings)
    levels = [finding.level for finding in findings]
    warned, broken, skipped = (levels.count(level) for level in (Level.WARN, Level.FAIL, Level.SKIP))
    counts = (
        f"{count(len(levels) - skipped, 'check')}, {count(warned, 'warning')}, {count(broken, 'failure')}"
    )
    counts += f", {skipped} not checked" if skipped else ""
    steps = []
    if check is not None and robot is not None:
        steps = _next_steps(check, robot, as_built, failed, NOT_POWERED in findings)
    line = f"{verdict[failed]}: {counts}"
    console.present({"findings": findings}, lambda: console.stdout().print(line), steps, as_json=as_json)
    if failed:
        raise typer.Exit(1)


def _has_terminal() -> bool:
    return sys.stdin.isatty()


def _refuse(options: Mapping[str, object], remedy: str) -> None:
    given = [name for name, value in options.items() if value]
    if given:
        raise InputError(f"{given[0]}: {remedy}")


def _examine(check: ArmCheck, *, quiet: bool) -> list[Finding]:
    """Run all checks of an arm, and print each finding immediately for a person at the arm."""
    findings: list[Finding] = []
    remark = f"emulated devices: {safe(describe_wires(check.robot_file))}" if check.wired else ""
    is_real = not check.wired and not is_simulated(check.robot_file)
    machine = [*real_time(), *memory_lock()] if is_real else []
    try:
        for finding in chain(machine, examine_arm(check)):
            if remark and not findings:
                console.stderr().print(remark)
            findings.append(finding)
            if quiet:
                continue
            mark = MARKS[finding.level] + " " * (4 - len(finding.level))
            console.say(f"{mark}  {safe(finding.subject):<{_SUBJECT_WIDTH}}  {safe(finding.text)}")
            if finding.remedy:
                console.say(f"{'':<{_SUBJECT_WIDTH + 8}}[cyan]→ {safe(finding.remedy)}[/cyan]")
    except KeyboardInterrupt:
        if check.move:
            console.stderr().print(AT_REST)
        raise
    return findings


def _next_steps(
    check: ArmCheck, robot: str, as_built: str | None, failed: bool, unpowered: bool
) -> list[tuple[str, str]]:
    """Suggest commands that follow a check, with the same options."""
    arm = f"--robot {as_shell_word(robot)}" + " --wire" * check.wired
    own = "".join(f" --drivers {as_shell_word(package)}" for package in check.drivers)
    again = f"palpate doctor {arm}" + (f" --as-built {as_shell_word(as_built)}" if as_built else "") + own
    if failed:
        return [(again + " --move" * check.move, "once the failures are corrected")]
    if is_simulated(check.robot_file):
        return [(f"palpate probe {arm}{own}", "a first probe")]
    if not check.move or unpowered:
        return [(f"{again} --move", "signs of joints and force, by hand and under power")]
    return [
        ("palpate calibrate --help", "calibrate zeros, force sensor, drives and base before the first touch"),
        (f"palpate probe {arm}{own} {FIRST_PROBE}", "then a first slow and gentle probe of something soft"),
    ]
