"""Files for tests: text or bytes, and tables with named columns."""

import numpy as np


def saved(path, content):
    """A file with this text or these bytes, as its path."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def write_csv(path, columns, delimiter=","):
    """A file of columns of numbers or text by their names, as its path; None leaves a column out."""
    cells = {name: np.asarray(values).tolist() for name, values in columns.items() if values is not None}
    rows = [cells, *zip(*cells.values(), strict=True)]
    return saved(path, "".join(delimiter.join(map(str, row)) + "\n" for row in rows))
