"""From which number the joints of a file count: the same for all their quantities."""

import shlex
from collections.abc import Iterable, Mapping

from estimation.data.column_guess import guess_column
from estimation.data.quantities import OF_JOINTS
from estimation.data.table import Table
from robot_io.errors import InputError

Numbered = dict[str, dict[int, str]]  # column of each joint of each quantity


def joint_shift(table: Table, columns: Mapping[str, str]) -> int:
    """What to add to the numbers of the joints so that they count from 1.

    Args:
        table: the rows.
        columns: what the user says, which goes before their names.

    Raises:
        InputError: positions and another quantity count from different numbers.
    """
    own = _numbered(name for name in table.names if name not in columns.values())
    for quantity in own:
        _check_start(table, own, quantity)
    return int(any(0 in joints for found in (own, _numbered(columns)) for joints in found.values()))


def _numbered(names: Iterable[str]) -> Numbered:
    found: Numbered = {}
    for one in map(guess_column, names):
        if one.quantity in OF_JOINTS and one.joint is not None:
            found.setdefault(one.quantity, {})[one.joint] = one.column
    if "position" not in found:  # then the forces are those of presses
        found.pop("force", None)
    return found


def _check_start(table: Table, own: Numbered, quantity: str) -> None:
    """Refuse what may be one joint's or the next one's."""
    positions, others = own.get("position", {}), own[quantity]
    if len(positions) != len(others) or {min(positions), min(others)} != {0, 1}:
        return
    first = min(positions)
    pairs = zip(sorted(positions), sorted(others), strict=True)
    remedy = " ".join(f"--column {quantity}_{joint}={shlex.quote(others[other])}" for joint, other in pairs)
    raise InputError(
        f"{table.path}: joints of position count from {first}, those of {quantity} from {1 - first}; "
        f"say which is whose, such as {remedy}"
    )
