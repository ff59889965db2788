"""A session file that is begun, with the sealed answer of what is hidden in its world, if anything is."""

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from palpate.arm.hiding import SEAL, seal_hidden
from robot_io.errors import InputError
from robot_io.session import SessionMetadata, SessionWriter, Stream
from sim_backend.scenario import Scenario


@dataclass(frozen=True)
class NewSession:
    """A session being written.

    Attributes:
        log: its writer.
        sealed: file with what was hidden in the simulated world, None if nothing was.
    """

    log: SessionWriter
    sealed: Path | None


@contextmanager
def new_session(
    path: Path,
    streams: list[Stream],
    metadata: SessionMetadata,
    scenario: Scenario | None,
    hidden: str | None,
    *,
    wait_for_room: bool,
) -> Iterator[NewSession]:
    """Begin a session; it is complete when the context ends.

    The session file is made before the answer is sealed, and neither replaces anything: of two programs that
    want the same name, one is refused before it has written anything.

    Args:
        path: the new session file.
        streams: the streams that will come.
        metadata: where the session comes from; the mark of its sealed answer is added.
        scenario: its simulated world; None with hardware.
        hidden: how what is hidden there was chosen, as for `seal_hidden`.
        wait_for_room: see `SessionWriter`.

    Raises:
        InputError: from here, or from within the context, where it says that nothing has moved; neither of
            the two files is left.
        SessionError: the session file is there already, or cannot be written.
    """
    mark = {SEAL: secrets.token_hex(16)} if scenario is not None and scenario.hidden else {}
    metadata = replace(metadata, extra={**metadata.extra, **mark})
    made = []
    with SessionWriter(path, streams, metadata, wait_for_room=wait_for_room) as log:
        made.append(path)
        try:
            sealed = seal_hidden(path, scenario, hidden, metadata) if scenario is not None else None
            made += [sealed] if sealed is not None else []
            yield NewSession(log, sealed)
        except InputError:
            log.close()
            for file in made:
                file.unlink(missing_ok=True)
            raise
