"""Diagnose the public recordings of benchmarks/measured/recipes, and compare each answer with its recipe.

    python benchmarks/recordings.py DATA_DIR [NAME ...] --out FILE [--answers FOLDER]

DATA_DIR has a folder for each recording with the import.csv.gz that benchmarks/measured/convert.py wrote;
missing recordings are skipped. If the recipe has `raw` (a list of options), the original files are diagnosed
instead, which also tests how files are read. A recording is judged by three criteria:

1. The kind with the largest share of the budget is an expected one. Recordings in which an expected kind is
   stated to explain as much in its place are also counted separately.
2. A form that the recipe accepts is named (or a newer effect of the same curve, see measured/score.py), or
   the form of the largest kind is stated to be unknown.
3. No name is wrong.

If the recipe has `verdicts`, any of these verdicts is right by itself. Recordings that are held out are run
once, by somebody who did not write the rules.
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
    """Return the words of the command that diagnoses a recording."""
    command = ["diagnose", str(file), "--json", "--model", recipe["model"]]
    for column in recipe.get("context", []):
        command += ["--context", column]
    return command + (["--fresh-runs"] if recipe.get("fresh_runs") else []) + recipe.get("raw", [])


def file_of(recipe: dict[str, Any], folder: Path) -> Path:
    """Return the diagnosed path: the converted file, the original file, or the folder of several files."""
    if "raw" not in recipe:
        return folder / "import.csv.gz"
    files = sorted((folder / "raw").glob("*"))
    return files[0] if len(files) == 1 else folder / "raw"


def answer_of(recipe: dict[str, Any], file: Path, kept: Path | None = None) -> dict[str, Any]:
    """Diagnose one recording with the command line.

    Args:
        recipe: how the recording was made and is diagnosed.
        file: the measurement.
        kept: file of the answer, which is read if it exists and written otherwise; None to keep nothing.

    Returns:
        Output of `palpate diagnose --json`, or under "refused" or "stopped" the reason why there is none,
        with the duration in seconds.
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
            raise RuntimeError(f"{file}: {last}")  # a program error says nothing about the recording
        answer = {"refused": last} if done.exit_code else dict(json.loads(done.stdout))
        answer["seconds"] = done.wall_s
    if kept is not None:
        kept.write_text(json.dumps(answer), encoding="utf-8")
    return answer


def run(recipe: dict[str, Any], file: Path, kept: Path | None) -> Score:
    """Diagnose one recording, and compare it with its recipe; refusals and stops count too."""
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
