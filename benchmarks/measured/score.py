"""Compare the diagnosis of a recording with its recipe."""

from dataclasses import dataclass
from typing import Any

from .convert import split_of

# Effects added after the recipes were written. If a recipe accepts the second name, the first is right.
_LATER_LAWS = {"softening_stiffness": "power_law_stiffness"}


@dataclass(frozen=True)
class Score:
    """The diagnosis of one recording, and whether it is right."""

    recording: str
    split: str
    verdict: str  # or `refused`, `stopped`
    reason: str
    rmse: tuple[float, float] | None  # held-out errors of the base model and of the last one
    budget: list[dict[str, Any]]
    accepted: list[str]
    expected: list[str]  # kinds
    kind: str | None  # largest kind of the budget
    kind_right: bool
    kind_stated: bool  # the same, or an expected kind is stated to explain as much in its place
    form_right: bool
    false_names: list[str]
    seconds: float  # wall-clock time


def share_of(entry: dict[str, Any]) -> float:
    """Return the share of a budget entry: `share`, or the mean of `necessary` and `sufficient`."""
    if entry.get("share") is not None:
        return float(entry["share"])
    return (float(entry.get("necessary") or 0.0) + float(entry.get("sufficient") or 0.0)) / 2.0


def score(recipe: dict[str, Any], channel: dict[str, Any], seconds: float) -> Score:
    """Compare the diagnosis of one channel with its recipe.

    Args:
        recipe: content of the recipe.
        channel: the channel's entry in the JSON of `palpate diagnose`; its `budget` may be missing.
        seconds: duration of the diagnosis.
    """
    expected = recipe["expected"]
    names = {name for group in expected["groups"].values() for name in group}
    names |= {later for later, earlier in _LATER_LAWS.items() if earlier in names}
    budget: list[dict[str, Any]] = channel.get("budget") or []
    leading = max(budget, key=share_of, default=None)
    accepted = [
        entry
        for entry in channel.get("accepted", [])
        if channel["verdict"] == "missing" and entry.get("form") != "unknown"
    ]
    wrong = [
        entry["effect"]
        for entry in accepted
        if not names & {entry["effect"], *entry.get("confused_with", [])}
    ]
    kinds = [leading["kind"], *leading.get("replaceable_by", [])] if leading else []
    unknown = leading is not None and leading.get("form") == "unknown"
    fair = channel["verdict"] in expected.get("verdicts", [])  # nothing is missing, or the data do not tell
    baseline, final = channel.get("baseline"), channel.get("final")
    return Score(
        recording=recipe["name"],
        split=split_of(recipe),
        verdict=channel["verdict"],
        reason=channel.get("reason", ""),
        rmse=(baseline["rmse"], final["rmse"]) if baseline and final else None,
        budget=budget,
        accepted=[entry["effect"] for entry in accepted],
        expected=expected["kinds"],
        kind=leading["kind"] if leading else None,
        kind_right=fair or not set(kinds[:1]).isdisjoint(expected["kinds"]),
        kind_stated=fair or not set(kinds).isdisjoint(expected["kinds"]),
        form_right=fair or len(wrong) < len(accepted) or (not accepted and unknown),
        false_names=wrong,
        seconds=seconds,
    )


def summary(results: list[Score]) -> str:
    """Summarize the three figures of each split, and the number of refused or stopped recordings."""
    lines = []
    for split in sorted({result.split for result in results}):
        part = [result for result in results if result.split == split]
        counts = {
            "kind right": sum(result.kind_right for result in part),
            "kind right or stated as possible": sum(result.kind_stated for result in part),
            "form right or honestly unknown": sum(result.form_right for result in part),
            "a false name": sum(bool(result.false_names) for result in part),
            "refused": sum(result.verdict == "refused" for result in part),
            "stopped": sum(result.verdict == "stopped" for result in part),
        }
        lines.append(
            f"{split}, {len(part)}: " + ", ".join(f"{what} {count}" for what, count in counts.items())
        )
    return "\n".join(lines) or "no recording was found"
