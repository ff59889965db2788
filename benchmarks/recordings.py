"""Diagnose the public recordings of benchmarks/measured/recipes, and hold each answer against its recipe.

    python benchmarks/recordings.py DATA_DIR [NAME ...] --out FILE [--answers FOLDER]

DATA_DIR has a folder for each recording with the import.csv.gz that benchmarks/measured/convert.py wrote; a
recording that it lacks is skipped. With `raw` in the recipe (a list of options) the origin's own files are
diagnosed instead, so that the reading of files is judged too. Three figures count. The kind with the largest
share of the budget is an expected one; recordings in which an expected kind is stated to explain as much
in its place are also counted separately. A form is named that the recipe accepts (or a younger
effect of the same curve, see measured/score.py), or the largest kind's form is said to
be unknown. No name is false. Where the recipe has `verdicts`, one of them is right by itself.
Recordings that are held out are run once, by somebody who did not write the rules.
"""

import json
import subprocess
from dataclasses import asdict
from pathlib import Path
from typing import Any

from harness import arguments, json_lines, run_palpate
from measured.convert import RECIPES, load_recipe
from measured.score import Score, score, share_of, summary

_TIME_LIMIT_S = 900
_BAD_INPUT = 2  # exit code if a recording cannot be read


def command_of(recipe: dict[str, Any], file: Path) -> list[str]:
    """Words of the command that diagnoses a recording."""
    command = ["diagnose", str(file), "--json", "--model", recipe["model"]]
    for column in recipe.get("context", []):
        command += ["--context", column]
    return command + (["--fresh-runs"] if recipe.get("fresh_runs") else []) + recipe.get("raw", [])


def file_of(recipe: dict[str, Any], folder: Path) -> Path:
    """What is diagnosed: the converted file, or the origin's file, or the folder of several."""
    if "raw" not in recipe:
        return folder / "import.csv.gz"
    files = sorted((folder / "raw").glob("*"))
    return files[0] if len(files) == 1 else folder / "raw"


def answer_of(recipe: dict[str, Any], file: Path, kept: Path | None = None) -> dict[str, Any]:
    """Diagnose one recording by the command line.

    Args:
        recipe: how the recording was made and is diagnosed.
        file: with the measurement.
        kept: the answer of an earlier run, which is read, or written; None to keep nothing.

    Returns:
        What `palpate diagnose --json` prints, or under "refused" or "stopped" why it prints nothing; with
        the seconds that it took.
    """
    if kept is not None and kept.is_file():
        return dict(json.loads(kept.read_text(encoding="utf-8")))
    try:
        done = run_palpate(*command_of(recipe, file), check=False, timeout_s=_TIME_LIMIT_S)
    except subprocess.TimeoutExpired:
        answer = {"stopped": f"no answer in {_TIME_LIMIT_S} s", "seconds": _TIME_LIMIT_S}
    else:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        if done.exit_code not in {0, _BAD_INPUT}:
            raise RuntimeError(f"{file}: {last}")  # a fault of the program says nothing about the recording
        answer = {"refused": last} if done.exit_code else dict(json.loads(done.stdout))
        answer["seconds"] = done.wall_s
    if kept is not None:
        kept.write_text(json.dumps(answer), encoding="utf-8")
    return answer


def run(recipe: dict[str, Any], file: Path, kept: Path | None) -> Score:
    """Diagnose one recording and hold it against its recipe; a refusal counts, and so does a stop."""
    answer = answer_of(recipe, file, kept)
    verdict = next((word for word in ("refused", "stopped") if word in answer), "")
    found = {"verdict": verdict, "reason": answer[verdict]} if verdict else answer["channels"][0]
    return score(recipe, found, answer["seconds"])


def show(result: Score) -> None:
    """Print one recording."""
    kind, form = ("right" if is_right else "WRONG" for is_right in (result.kind_right, result.form_right))
    names = f", FALSE {', '.join(result.false_names)}" if result.false_names else ""
    print(f"\n{result.recording}: {result.verdict}; kind {kind}, form {form}{names} ({result.seconds:.0f} s)")
    print(f"  {result.reason}")
    for entry in sorted(result.budget, key=share_of, reverse=True):
        low, high = sorted(100.0 * float(entry.get(key) or 0.0) for key in ("necessary", "sufficient"))
        effects = ", ".join(entry.get("effects") or [])
        print(f"  {entry['kind']}: {low:.0f} to {high:.0f} %, form {entry.get('form')}: {effects}")
    print(f"  accepted: {', '.join(result.accepted) or 'none'}; expected: {', '.join(result.expected)}")


def main() -> None:
    """Run the recordings named on the command line, or all that the folder has."""
    parser = arguments(__doc__)
    known = sorted(path.stem for path in RECIPES.glob("*.yaml"))
    parser.add_argument("data_dir", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(known))
    parser.add_argument("--out", type=Path, help="JSON lines, one a recording")
    parser.add_argument("--answers", type=Path, help="folder that keeps diagnoses; one that is there is read")
    options = parser.parse_args()
    if unknown := set(options.names) - set(known):
        parser.error(f"no such recipe: {', '.join(sorted(unknown))}")
    if options.answers:
        options.answers.mkdir(parents=True, exist_ok=True)
    results: list[Score] = []
    with json_lines(options.out) as write:
        for name in options.names or known:
            recipe = load_recipe(name)
            file = file_of(recipe, options.data_dir / name)
            if not file.exists():
                print(f"\n{name}: skipped, there is no {file}")
                continue
            kept = options.answers / f"{name}.json" if options.answers else None
            results.append(run(recipe, file, kept))
            show(results[-1])
            write(asdict(results[-1]))
    print(f"\n{summary(results)}")


if __name__ == "__main__":
    main()
