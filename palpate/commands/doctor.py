"""`palpate doctor`: does this machine have what palpate needs?"""

from typing import Annotated

import typer

from palpate import console
from palpate.doctor import Finding, Level, examine_all

MARKS = {
    Level.OK: "[green]ok[/green]",
    Level.WARN: "[yellow]warn[/yellow]",
    Level.FAIL: "[bold red]fail[/bold red]",
}


def command(
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Examine this machine: Python, packages, PyBullet, viewer, real-time rights, ports.

    Ends with 0 when palpate will work here, and 1 when something is broken.
    """
    findings = list(examine_all())
    if as_json:
        console.print_json({"findings": [vars(finding) for finding in findings]})
    else:
        _print_table(findings)
    if any(finding.level is Level.FAIL for finding in findings):
        raise typer.Exit(1)


def _print_table(findings: list[Finding]) -> None:
    table = console.table("", "", "subject", "finding")
    for finding in findings:
        remedy = f"\n[cyan]→ {finding.remedy}[/cyan]" if finding.remedy else ""
        table.add_row(MARKS[finding.level], finding.subject, finding.text + remedy)
    console.stdout().print(table)
    failed = sum(finding.level is Level.FAIL for finding in findings)
    warned = sum(finding.level is Level.WARN for finding in findings)
    verdict = "palpate will not work here" if failed else "palpate works here"
    console.stdout().print(f"{verdict}: {len(findings)} checks, {warned} warnings, {failed} failures")
