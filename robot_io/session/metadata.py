"""What a session says about itself, so that it can be understood alone."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from datetime import datetime

from robot_io.errors import InputError, SessionError


@dataclass(frozen=True)
class SessionMetadata:
    """Where a session comes from. Texts are whole files, not paths; what there is none of stays empty.

    InputError: a value of the wrong type, or a date that is none.
    """

    robot_file: str = ""  # text of the robot file
    urdf: str = ""  # text of the arm's URDF
    calibration: str = ""  # text of the calibration that was applied
    scenario: str = ""  # text of the simulated scenario
    software_version: str = ""  # version of palpate
    seed: int | None = None  # of every random number in the run; None if nothing was drawn
    created_utc: str = ""  # start of the session on the wall clock, ISO 8601
    command_line: str = ""  # how the program was started
    extra: Mapping[str, str] = field(default_factory=dict)  # whatever else is worth keeping

    def __post_init__(self) -> None:
        texts = {name: getattr(self, name) for name in _TEXTS} | dict(self.extra)
        for name, value in texts.items():
            if not isinstance(name, str) or not isinstance(value, str):
                raise InputError(f"session metadata '{name}': {value!r} is not text")
        if self.seed is not None and not isinstance(self.seed, int):
            raise InputError(f"session metadata 'seed': {self.seed!r} is not a whole number")
        try:
            if self.created_utc:
                datetime.fromisoformat(self.created_utc)
        except ValueError as error:
            raise InputError(
                f"session metadata 'created_utc': {self.created_utc!r} is not ISO 8601"
            ) from error

    def to_strings(self) -> dict[str, str]:
        """All but `extra`, as the file's header keeps it."""
        return {name: getattr(self, name) for name in _TEXTS} | {
            "seed": "" if self.seed is None else str(self.seed)
        }

    @classmethod
    def from_strings(cls, strings: Mapping[str, str], extra: Mapping[str, str]) -> "SessionMetadata":
        """Read back what `to_strings` made. SessionError: a value is not valid."""
        seed = strings.get("seed", "")
        try:
            texts = {name: strings.get(name, "") for name in _TEXTS}
            return cls(**texts, seed=int(seed) if seed else None, extra=dict(extra))
        except ValueError as error:
            raise SessionError(f"the session's metadata is not valid: {error}") from error


_TEXTS = tuple(f.name for f in fields(SessionMetadata) if f.name not in {"seed", "extra"})
