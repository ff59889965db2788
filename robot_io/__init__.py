"""Hardware abstraction: measurements, commands, drivers, robot file, clock, guard and session log."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palpate.robot_io.session import (
        Column,
        Samples,
        Session,
        SessionMetadata,
        SessionWriter,
        Stream,
        write_session,
    )

__all__ = ["Column", "Samples", "Session", "SessionMetadata", "SessionWriter", "Stream", "write_session"]


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """Import `palpate.robot_io.session` on first use, because types and errors need no MCAP library."""
    if name in __all__:
        from palpate.robot_io import session  # noqa: PLC0415

        return getattr(session, name)
    raise AttributeError(f"module 'palpate.robot_io' has no attribute '{name}'")
