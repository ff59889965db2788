"""Which columns the user's units are meant for."""

from estimation.data.import_options import ImportOptions
from estimation.data.quantities import Role, parse_role
from estimation.data.table import Table


def units_meant(table: Table, options: ImportOptions, role: Role, column: str) -> list[str]:
    """The names in --unit that mean a column: its own, its quantity, or its quantity and joint.

    A name that a column has means that one alone, unless the user calls another one so.
    """
    exact = {name for name in table.names if name not in options.columns or name in options.columns.values()}
    return [name for name in options.units if name == column or (name not in exact and _is_of(name, role))]


def _is_of(named: str, role: Role) -> bool:
    said = parse_role(named, role.shift)
    return named == role.quantity or (said is not None and said.key == role.key)
