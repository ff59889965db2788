"""One press as columns and as the text of a table, and what must be read of it."""

import shlex
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pytest

from palpate.estimation.data.file_columns import FileColumns
from palpate.estimation.data.import_file import import_file, import_table
from palpate.estimation.data.import_options import ImportOptions, parse_pairs
from palpate.estimation.data.table import table_of
from palpate.robot_io.errors import InputError
from tests.estimation.laboratories import presses

TIME_S, WAY_M, FORCE_N = (signal[:600] for signal in presses())
HEADER = "Time [s],Travel [mm],Load [N]\n"


def rows(delimiter=",", decimal=".", *, before="", behind=""):
    """The press in s, mm and N, as lines."""
    cells = np.column_stack([TIME_S, 1e3 * WAY_M, FORCE_N])
    texts = (delimiter.join(f"{value:.6f}" for value in row) for row in cells)
    return "".join(before + text.replace(".", decimal) + behind + "\n" for text in texts)


def lines(*columns, delimiter=",", form="{:.6f}"):
    """Rows of a table."""
    return "".join(delimiter.join(map(form.format, row)) + "\n" for row in zip(*columns, strict=True))


def imported(options=None, **columns):
    """What is read of columns in memory."""
    return import_table(table_of(FileColumns(pa.table(columns)), "press"), options or ImportOptions())


def check_press(imported, tests=1):
    """The contact has the displacement and the force of so many presses, to the written digits."""
    (channel,) = imported.channels
    assert (channel.name, len(channel.runs)) == ("contact", tests)
    np.testing.assert_allclose(channel.position, np.tile(WAY_M, tests), atol=1e-8)
    np.testing.assert_allclose(channel.effort, np.tile(FORCE_N, tests), atol=1e-6)


def refusal(path, **options):
    """The line that refuses a file."""
    with pytest.raises(InputError) as caught:
        import_file(path, ImportOptions(**options))
    text = str(caught.value)
    assert "\n" not in text
    return text


def by_the_advice(path):
    """What is read with the options that a refusal says, word for word."""
    text = refusal(path)
    said = list(pairwise(shlex.split(text[text.index("--") :])))
    columns, units = (
        parse_pairs([value for at, value in said if at == option], option)
        for option in ("--column", "--unit")
    )
    context = tuple(value for at, value in said if at == "--context")
    return import_file(path, ImportOptions(columns=columns, units=units, context=context))
