"""Write docs/reference/recordings.md: the diagnoses of public recordings.

    python docs/make_recordings.py DATA_DIR [DATA_DIR ...] --answers FOLDER

A DATA_DIR holds recordings by name: `NAME/import.csv.gz` or `NAME/raw`, as benchmarks/measured/convert.py
writes them by a recipe. Missing recordings are left out, or keep their place on the page with `--keep`. The
folder of answers keeps one JSON file per recording; an existing diagnosis is reused. Pictures are drawn from
the answers.
"""

import re
import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))  # the benchmarks are no installed package

from measured.convert import RECIPES, load_recipe, split_of
from recordings import answer_of, file_of

from palpate.estimation.diagnosis import ChannelDiagnosis
from palpate.estimation.kinds import Kind
from palpate.render.diagnosis import budget_svg, budget_view, diagnosis_verdict

PAGE = Path(__file__).parent / "reference" / "recordings.md"
PICTURES = Path(__file__).parent / "pictures" / "recordings"
_PLACE = re.compile(r"^palpate: |/\S*/(?:raw/)?\d+ ")  # in a message, where the file lies, and its number
WIDTH = 900  # of a picture [px]
INK = "#768390"  # reads on light and on dark
INTRODUCTION = """# Recordings

This page shows what `palpate diagnose` reports on published measurements of others. A picture shows
the error budget ([diagnosis](../explanation/diagnosis.md)): the squared error of a simple base model in
held-out runs, divided among kinds of effects, noise and an unexplained part. The dot is the share of a kind.
Its range goes from the share that the kind explains alone to the share that it adds to all other kinds, the
smaller first. The expected kinds come from the publication or from plain least-squares fits; the recipe of a
recording, `benchmarks/measured/recipes/NAME.yaml`, states the reasons. *Held out* means that nothing was
developed on the recording before its first diagnosis. The data are not part of this project.
"""
TABLE_HEAD = ["| recording | verdict | largest kind | missing effects |", "|---|---|---|---|"]


@dataclass
class Entry:
    """One recording on the page."""

    name: str
    measured: str  # what it is, in a sentence
    origin: str  # where the data are, as Markdown
    expected: str
    split: str  # "developed on" or "held out"
    channels: list[ChannelDiagnosis] = field(default_factory=list)
    refused: str = ""  # why there is no answer


def main() -> None:
    """Diagnose what has no answer yet, and write the page."""
    options = _options()
    options.answers.mkdir(parents=True, exist_ok=True)
    entries = list(_of_recipes(options))
    PICTURES.mkdir(parents=True, exist_ok=True)
    rows: dict[str, list[str]] = {}
    sections: dict[str, str] = {}
    if options.keep:
        rows, sections = _read_page(PAGE.read_text(encoding="utf-8"))
    else:
        for old in PICTURES.glob("*.svg"):
            old.unlink()
    for entry in entries:
        rows[entry.name], sections[entry.name] = list(_rows(entry)), _section(entry)
    names = sorted(name for name in sections if (RECIPES / f"{name}.yaml").is_file())
    table = [*TABLE_HEAD, *(row for name in names for row in rows[name]), ""]
    PAGE.write_text("\n".join([INTRODUCTION, *table, *map(sections.get, names)]), encoding="utf-8")


def _read_page(text: str) -> tuple[dict[str, list[str]], dict[str, str]]:
    """Split a page into the rows of its table and its sections, by the name of the recording."""
    head, *parts = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    sections = {part.partition("\n")[0].removeprefix("## "): f"{part.rstrip()}\n" for part in parts}
    rows = {name: re.findall(rf"^\| \[{re.escape(name)}\].*$", head, re.MULTILINE) for name in sections}
    return rows, sections


def _options() -> Namespace:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("data_dirs", type=Path, nargs="+", metavar="DATA_DIR")
    parser.add_argument("--answers", type=Path, required=True, help="folder that keeps diagnoses")
    parser.add_argument("--keep", action="store_true", help="keep what the page says of other recordings")
    parser.add_argument("--no-new", action="store_true", help="diagnose nothing; show what has an answer")
    return parser.parse_args()


def _of_recipes(options: Namespace) -> Iterator[Entry]:
    """Recordings that a recipe describes, of which the data are there."""
    for name in sorted(path.stem for path in RECIPES.glob("*.yaml")):
        recipe, answer, folder = load_recipe(name), options.answers / f"{name}.json", _folder(options, name)
        if folder is None or not (file := file_of(recipe, folder)).exists():
            continue
        if not answer.is_file() and options.no_new:
            continue
        print(name, flush=True)
        content, origin = answer_of(recipe, file, answer), recipe["origin"]
        place = f"[{origin['repository'].removeprefix('https://github.com/')}]({origin['repository']})"
        command = f"`python benchmarks/measured/convert.py {name} --from REPOSITORY --to FOLDER`"
        yield Entry(
            name=name,
            measured=recipe["measured"],
            origin=f"{place} at {origin['commit'][:7]}, license: {origin['licence']}; {command}",
            expected=" or ".join(Kind(kind).word for kind in recipe["expected"]["kinds"]),
            split=split_of(recipe).replace("_", " ").replace("develop", "developed on"),
            channels=[ChannelDiagnosis.model_validate(one) for one in content.get("channels", [])],
            refused=_PLACE.sub("", content.get("refused", content.get("stopped", ""))),
        )


def _folder(options: Namespace, name: str) -> Path | None:
    return next(filter(Path.is_dir, (folder / name for folder in options.data_dirs)), None)


def _rows(entry: Entry) -> Iterator[str]:
    """Rows of a recording in the table of all recordings."""
    link = f"[{entry.name}](#{entry.name})"
    if entry.refused:
        yield f"| {link} | refused | | |"
    for channel in entry.channels:
        where = "" if len(entry.channels) == 1 else f" {channel.channel}"
        kind = channel.budget[0].kind.word if channel.budget else ""
        names = ", ".join(
            f"{one.effect} ({one.form.value})" if one.form.value != "exact" else one.effect
            for one in channel.accepted
        )
        yield f"| {link}{where} | {channel.verdict.value} | {kind} | {names} |"


def _section(entry: Entry) -> str:
    """Write the section of one recording: description, expected kinds, diagnosis and origin of the data."""
    lines = [f"## {entry.name}", "", f"{entry.measured} ({entry.split})", ""]
    lines += [f"**Expected kinds**: {entry.expected}.", ""]
    if entry.refused:
        lines += [f"**Diagnosis**: refused. {entry.refused}", ""]
    for channel in entry.channels:
        budget, verdict = budget_view(channel), diagnosis_verdict(channel)
        if budget is not None:
            name = f"{entry.name}-{channel.channel}.svg"
            (PICTURES / name).write_text(budget_svg(budget, WIDTH, INK) + "\n", encoding="utf-8")
            lines += [budget.sentence, "", f"![error budget](../pictures/recordings/{name})", ""]
            lines += [line for confusion in budget.confusions for line in (confusion, "")]
        lines += [f"**Diagnosis**: *{verdict.word}*. {verdict.sentence}", ""]
    return "\n".join([*lines, f"**Data**: {entry.origin}.", ""])


if __name__ == "__main__":
    main()
