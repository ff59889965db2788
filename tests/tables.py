"""Text files with named columns, as programs write them."""

import numpy as np


def write_csv(path, columns, delimiter=","):
    """A file of columns of numbers or text by their names, as its path; None leaves a column out."""
    cells = {name: np.asarray(values).tolist() for name, values in columns.items() if values is not None}
    rows = [cells, *zip(*cells.values(), strict=True)]
    path.write_text("".join(delimiter.join(map(str, row)) + "\n" for row in rows))
    return path
