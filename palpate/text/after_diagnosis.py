"""What to type after a diagnosis."""

from collections.abc import Iterable
from dataclasses import dataclass

from estimation.diagnosis import ChannelDiagnosis, Diagnosis, Verdict
from palpate.findings.estimation_run import Material
from palpate.findings.subject import ALL_CHANNELS
from palpate.words import as_shell_word

MOST_ASKED = 3  # unused columns that are pointed out
Steps = list[tuple[str, str]]  # commands, and what each is for


@dataclass(frozen=True)
class Ways:
    """What there is to go on from.

    Attributes:
        diagnose: what follows the name of that command: the file, with the options that it takes.
        add: the same of `add`.
        compare: of `compare`.
        kept: of commands that go on from revisions.
        others: commands with another base model, where that does far better, each with what it does.
        applied: whether what is missing was added already.
        again: the command that probes again by the next experiment, if one was written.
        why_all: what judging the channels that were left out would tell, if anything.
        afresh: whether more would be explained if no run remembered another.
    """

    diagnose: str
    add: str
    compare: str
    kept: str
    others: tuple[tuple[str, str], ...] = ()
    applied: bool = False
    again: str | None = None
    why_all: str | None = None
    afresh: bool = False


def after_diagnosis(material: Material, diagnosis: Diagnosis, ways: Ways) -> Steps:
    """Commands that go on from a diagnosis, the nearest first."""
    steps = [*_what_was_found(material, ways, diagnosis), *ways.others]
    if ways.again is not None:
        steps.append((ways.again, "the experiment that would tell more"))
    if ways.afresh:
        told = "if each run met a fresh spot: that explains more"
        steps.append((f"palpate diagnose {ways.diagnose} --fresh-runs", told))
    if ways.why_all:
        steps.append((f"palpate diagnose {ways.add} --channel {ALL_CHANNELS}", ways.why_all))
    if any(found.verdict is Verdict.UNEXPLAINED for found in diagnosis.channels):
        steps += _hypotheses(material, ways)
    return [*steps, (f"palpate compare {ways.compare}", "where the model fails")]


def _hypotheses(material: Material, ways: Ways) -> Steps:
    """What the user may know, and the program does not."""
    columns = [
        (f"palpate diagnose {ways.diagnose} --context {as_shell_word(name)}", f"whether it depends on {name}")
        for name in material.unused[:MOST_ASKED]
    ]
    own = f"palpate diagnose {ways.diagnose} --effect my_effects.py:MyEffect"
    return [*columns, (own, "try a hypothesis of your own")]


def _what_was_found(material: Material, ways: Ways, diagnosis: Diagnosis) -> Steps:
    """What to do with the effects that are missing; without any, with those that are suspected."""
    missing = [found for found in diagnosis.channels if found.accepted]
    if not missing:
        return _suspected(material, ways.add, diagnosis)
    if ways.applied:
        return [
            (f"palpate export {ways.kept}", "the improved model as a simulated world"),
            (f"palpate revisions {ways.kept}", "all stages, to go back to"),
        ]
    return [
        (
            _added(material, ways.add, found, [entry.effect for entry in found.accepted]),
            "refit with it, and keep that as a revision",
        )
        for found in missing
    ]


def _suspected(material: Material, typed: str, diagnosis: Diagnosis) -> Steps:
    """The commands that add what would help though it does not complete a model."""
    return [
        (
            _added(material, typed, found, [suspect.effect for suspect in found.suspects]),
            "see how far that takes the model",
        )
        for found in diagnosis.channels
        if found.suspects
    ]


def _added(material: Material, typed: str, found: ChannelDiagnosis, effects: Iterable[str]) -> str:
    """The command that adds effects to a channel, which it names if another could be meant."""
    alone = len(material.channels) == 1 or found.channel == "contact"
    channel = "" if alone else f" --channel {found.channel}"
    return f"palpate add {typed} {' '.join(effects)}{channel}"
