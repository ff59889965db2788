"""Options of every command that reads a data file."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from palpate.common import console
from palpate.common.console import as_shell_word, shell_path
from palpate.common.files import existing_data
from palpate.common.options import model_names, with_options
from palpate.estimation.data.import_options import ImportOptions, parse_pairs
from palpate.robot_io.errors import InputError

if TYPE_CHECKING:
    from palpate.study import Study

_FOLDER = "Folder of the revisions; default: beside the data."
FolderOption = Annotated[Path | None, Option(help=_FOLDER, metavar="FOLDER")]
_FORCE = "Replace existing files of the same names in the folder of --out."
ForceOption = Annotated[bool, Option("--force", help=_FORCE)]
_MODEL = (
    "Base model, such as kelvin_voigt (an unknown name prints the list); default: the usual model of each "
    "channel."
)
ModelOption = Annotated[str | None, Option(help=_MODEL, autocompletion=model_names)]


_COLUMN = "Column of a quantity in the file, such as force_N=load, run=trial or phase=state."
_UNIT = "Unit of a quantity or column, such as force=mN or time=ms."
_WHERE = "Use only rows with this text in a column, such as specimen=P002; for a session, run=0,2."
_FRESH_RUNS = "Each run pressed a fresh specimen or spot, so no run affects another."
_TABLE = "Table to read: the name of its sheet or the line number of its header; default: the longest."
_CONTEXT = "Another numeric column to use as a signal."
_RUNS = "Number of presses in a recording; default: detected."


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """How to read a data file, as the user typed it."""

    column: Annotated[list[str] | None, Option(help=_COLUMN, metavar="NAME=COLUMN")] = None
    unit: Annotated[list[str] | None, Option(help=_UNIT, metavar="NAME=UNIT")] = None
    where: Annotated[list[str] | None, Option(help=_WHERE, metavar="COLUMN=TEXT")] = None
    context: Annotated[list[str] | None, Option(help=_CONTEXT, metavar="COLUMN")] = None
    fresh_runs: Annotated[bool, Option("--fresh-runs", help=_FRESH_RUNS)] = False
    runs: Annotated[int | None, Option(min=1, help=_RUNS, metavar="N")] = None
    table: Annotated[str | None, Option(help=_TABLE, metavar="TABLE")] = None

    def given(self, declared: type) -> dict[str, Any]:
        """Return the options of a class, as `shell_options` takes them.

        Args:
            declared: class of this object, or one from which it is derived.
        """
        values = {field.name.replace("_", "-"): getattr(self, field.name) for field in fields(declared)}
        return {name: value for name, value in values.items() if name != "file"}

    @property
    def options(self) -> ImportOptions:
        """How to read a data file.

        Raises:
            InputError: an option is not of the form NAME=VALUE, or is given twice.
        """
        return ImportOptions(
            columns=parse_pairs(self.column or (), "--column"),
            units=parse_pairs(self.unit or (), "--unit"),
            where=parse_pairs(self.where or (), "--where"),
            context=tuple(self.context or ()),
            fresh=self.fresh_runs,
            runs=self.runs,
            table=self.table or "",
        )


_EFFECT = "Add your own effect to the candidates; the file is executed."
_URDF = "URDF of the arm, for models that need one."
_TIP_FRAME = "Tip frame in this URDF; default: tip, otherwise the last link."


@dataclass(frozen=True, kw_only=True)
class StudyOptions(ReadOptions):
    """How to read and model a data file, as the user typed it."""

    effect: Annotated[list[str] | None, Option(help=_EFFECT, metavar="FILE.py:CLASS")] = None
    urdf: Annotated[Path | None, Option(help=_URDF, metavar="FILE")] = None
    tip_frame: Annotated[str | None, Option(help=_TIP_FRAME)] = None


_FILE = "Session (.mcap), folder of sessions, or data file (.csv, .xlsx, .parquet, .npz ...)."
_HELD_OUT = (
    "Runs to exclude from fitting, such as 2,5; with compare and add, models are scored only on these. "
    "Default: each run is predicted from the others."
)


@dataclass(frozen=True, kw_only=True)
class DataArguments(StudyOptions):
    """The file of a command with its options, as the user typed them."""

    file: Annotated[Path, Argument(help=_FILE)]
    held_out: Annotated[str | None, Option(help=_HELD_OUT, metavar="RUNS")] = None

    def study(
        self, model: str | None = None, folder: Path | None = None, like: "Study | None" = None
    ) -> "Study":
        """Open the study of this file.

        Args:
            model: base model; None for the usual one of each channel.
            folder: folder of the revisions; None for the usual one.
            like: study of another file, whose notes were printed and are not repeated.

        Raises:
            InputError: the data cannot be used.
        """
        from palpate.estimation.data_quality import list_warnings  # noqa: PLC0415, takes a second
        from palpate.study import Study, arm_from_urdf  # noqa: PLC0415, as above

        existing_data(self.file)
        if self.urdf is None and self.tip_frame is not None:
            raise InputError(f"--tip-frame {self.tip_frame}: needs --urdf FILE")
        arm = None if self.urdf is None else arm_from_urdf(self.urdf, self.tip_frame)
        held_out, read = _run_numbers(self.held_out), self.options.stated()
        study = Study(
            self.file, model, arm=arm, effects=self.effect or (), folder=folder, held_out=held_out, **read
        )
        warnings = list_warnings(study.warnings.items())
        earlier_notes = (like.source.read, *like.notes) if like is not None else ()
        notes = [note for note in (*study.notes, *warnings) if note not in earlier_notes]
        console.print_read_notes("" if study.source.read in earlier_notes else study.source.read, notes)
        return study

    def refuse_unknown(self, model: str | None) -> None:
        """Refuse unknown models and invalid run numbers before anything is read.

        Args:
            model: base model; None for the usual one of each channel.

        Raises:
            InputError: the model is unknown, or the run numbers are invalid.
        """
        from palpate.estimation.models import MODELS  # noqa: PLC0415, as above

        _run_numbers(self.held_out)
        if model is not None:
            MODELS[model]

    @staticmethod
    def refuse_idle_force(out: Path | None, *, force: bool) -> None:
        """Refuse --force without the folder of --out, in which alone it replaces files."""
        if force and out is None:
            raise InputError("--force has no effect without --out; add --out FOLDER, or omit --force")

    def print_omitted(self) -> None:
        """Report the held-out runs that a command leaves out without scoring on them."""
        if self.held_out:
            words = (
                f"--held-out {self.held_out}: this command leaves these runs out; palpate compare and "
                "palpate add compute errors on them"
            )
            console.stderr().print(words)

    def command_text(self, **more: Any) -> str:  # noqa: ANN401, as `shell_options`
        """Return the file with all options as one would type them again.

        Args:
            more: further options, or others instead of those given; see `shell_options`.
        """
        return shell_options(self.file, **{**self.given(DataArguments), **more})


def _run_numbers(text: str | None) -> list[int]:
    try:
        runs = [int(part) for part in text.split(",")] if text else []
    except ValueError:
        raise InputError(f"--held-out {text}: give run numbers separated by commas, such as 2,5") from None
    if len(runs) > len(set(runs)):
        raise InputError(f"--held-out {text}: a run is named twice; name each run once")
    return runs


takes_data = with_options(DataArguments, "file")
may_take_data = with_options(DataArguments, "file", file=Path())  # without a file `data.file` is the folder


def shell_options(file: Path, **options: Any) -> str:  # noqa: ANN401, values of any option
    """Return the file with its options as a command line, for suggested commands.

    Args:
        file: session or data file.
        options: values by the name of the option; None, or False for a flag, where it was not given.
    """
    words = [shell_path(file)]
    for name, value in options.items():
        for each in value if isinstance(value, list) else [value]:
            if each is True:
                words.append(f"--{name}")
            elif each is not None and each is not False:
                words += [f"--{name}", as_shell_word(str(each))]
    return " ".join(words)
