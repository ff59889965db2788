"""The sealed answer beside a session: what was hidden, in a file that cannot be read by accident."""

import base64
import binascii
import json
import zlib
from dataclasses import dataclass
from pathlib import Path

from robot_io.errors import InputError
from sim_backend.imperfection import Imperfection, describe_imperfection, parse_imperfection

SUFFIX = ".sealed"
_TITLE = "palpate sealed answer, version 1"
_HOW = "What was hidden in the session of this name. To open it: palpate reveal"
_MAX_BYTES = 1_000_000
_LINE = 76


@dataclass(frozen=True, slots=True)
class SealedAnswer:
    """Hidden effects of one session."""

    hidden: tuple[Imperfection, ...]  # the effects
    seed: int | None  # that they were drawn from; None where a scenario named them
    made_utc: str  # when the session was made, as it says itself
    mark: str = ""  # random text that the session holds as well; tells answers of equal name apart


def sealed_path(session: str | Path) -> Path:
    """Return the path of a session's sealed answer.

    Args:
        session: path of the session file.

    Returns:
        The session's whole name with a suffix.
    """
    return Path(f"{session}{SUFFIX}")


def seal(session: str | Path, answer: SealedAnswer) -> Path:
    """Write the sealed answer beside a session file, whole or not at all; nothing is replaced.

    Args:
        session: path of the session file.
        answer: to seal.

    Returns:
        Path of the sealed file.

    Raises:
        InputError: the file exists already, or cannot be written.
    """
    path = sealed_path(session)
    data = {
        "hidden": [describe_imperfection(entry) for entry in answer.hidden],
        "seed": answer.seed,
        "made_utc": answer.made_utc,
        "mark": answer.mark,
    }
    code = base64.b64encode(zlib.compress(json.dumps(data).encode())).decode()
    lines = [_TITLE, _HOW, "", *(code[start : start + _LINE] for start in range(0, len(code), _LINE)), ""]
    try:
        with path.open("x", encoding="ascii") as file:
            try:
                file.write("\n".join(lines))
                file.flush()
            except OSError:
                path.unlink(missing_ok=True)
                raise
    except FileExistsError as error:
        raise InputError(f"{path}: exists already, and a sealed answer replaces nothing") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
    return path


def unseal(path: str | Path) -> SealedAnswer:
    """Open a sealed answer.

    Args:
        path: of the sealed file.

    Returns:
        The answer.

    Raises:
        InputError: there is none, or it is damaged or of another version.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    title, *rest = content.split(b"\n")
    if title.strip() != _TITLE.encode():
        raise InputError(f"{path}: not a sealed answer; its first line would be '{_TITLE}'")
    try:
        return _parse(b"".join(rest[1:]), len(content))
    except (ValueError, KeyError, TypeError, binascii.Error, zlib.error) as error:
        raise InputError(f"{path}: damaged, its answer cannot be read ({error!s:.100})") from error


def _parse(code: bytes, size: int) -> SealedAnswer:
    if size > _MAX_BYTES:
        raise ValueError(f"larger than {_MAX_BYTES} bytes")
    inflater = zlib.decompressobj()
    text = inflater.decompress(base64.b64decode(code, validate=True), _MAX_BYTES)
    if not inflater.eof:
        raise ValueError("cut off, or larger than any answer")
    answer = json.loads(text)
    seed, made_utc, mark = answer["seed"], answer["made_utc"], answer.get("mark", "")
    if not (isinstance(seed, int | None) and isinstance(made_utc, str) and isinstance(mark, str)):
        raise TypeError("seed, date or mark is of the wrong type")
    return SealedAnswer(tuple(parse_imperfection(entry) for entry in answer["hidden"]), seed, made_utc, mark)
