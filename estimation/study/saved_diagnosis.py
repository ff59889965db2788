"""Save a diagnosis, and read it again for the same data and base models."""

import json
from collections.abc import Iterator, Mapping
from functools import lru_cache
from hashlib import sha256
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from palpate.estimation.diagnosis import ChannelDiagnosis, Diagnosis
from palpate.robot_io.errors import InputError

RESULT = "diagnosis.json"
_TOLERANCE = 1e-3  # difference up to which two fits agree, relative to the value or its standard error
IDENTITY = "judged"  # key of the data and base models to which the file refers


class _Identity(BaseModel):
    """Identity of the data and base model of a saved channel diagnosis."""

    model: str
    data_sha256: str


class _SavedDiagnosis(Diagnosis):
    """A file with a saved diagnosis."""

    judged: dict[str, _Identity]


def read_saved_diagnoses(folder: Path | None) -> dict[tuple[str, str, str], ChannelDiagnosis]:
    """Read the saved diagnoses of a folder, by channel, base model and SHA-256 of the data.

    Args:
        folder: folder of the study; None if the study has none.

    Raises:
        InputError: the file is damaged.
    """
    saved = _read(folder)
    if folder is None or saved is None:
        return {}
    try:
        identities = [(entry, saved.judged[entry.channel]) for entry in saved.channels]
    except KeyError as error:
        raise _damaged(folder / RESULT, f"{IDENTITY}: has no entry for {error.args[0]}") from error
    return {(entry.channel, its.model, its.data_sha256): entry for entry, its in identities}


def with_saved_channels(content: Mapping[str, Any], folder: Path | None) -> dict[str, Any]:
    """Add a folder's saved verdicts on channels that a new diagnosis does not contain.

    Verdicts on other data are omitted. Those on another base model are kept with the name of that model.

    Args:
        content: content of the new file, see `ModelStudy.diagnosis_data`.
        folder: folder of the study; None if the study has none.

    Raises:
        InputError: the saved file is damaged.
    """
    saved = _read(folder)
    new = {entry["channel"] for entry in content["channels"]}
    identities, entries = dict(content[IDENTITY]), list(content["channels"])
    earlier = [] if saved is None else [(entry, saved.judged.get(entry.channel)) for entry in saved.channels]
    for channel, known in earlier:
        name = channel.channel
        data = identities.get(name, {}).get("data_sha256")
        if name not in new and known is not None and known.data_sha256 == data:
            identities[name] = known.model_dump(mode="json")
            entries.append(channel.model_dump(mode="json"))
    order = list(content[IDENTITY])
    entries.sort(key=lambda entry: order.index(entry["channel"]))
    models = dict.fromkeys(identities[entry["channel"]]["model"] for entry in entries)
    whole = {key: value for key, value in content.items() if key != _CHECKSUM}
    return with_checksum(whole | {"model": "+".join(models), "channels": entries, IDENTITY: identities})


def _read(folder: Path | None) -> _SavedDiagnosis | None:
    """Return the saved diagnosis of a folder, read again only if the file changed; None without a file."""
    file = None if folder is None else folder / RESULT
    if file is None or not file.exists():
        return None
    state = file.stat()
    return _read_version(file, (state.st_mtime_ns, state.st_size, state.st_ino))


@lru_cache(maxsize=1)
def _read_version(file: Path, version: tuple[int, ...]) -> _SavedDiagnosis:
    """Read one version of a file; a report asks for it several times for each channel."""
    try:
        return read_saved(file, _SavedDiagnosis)
    except ValueError as error:
        raise _damaged(file, error) from error


def _damaged(file: Path, flaw: object) -> InputError:
    return InputError(f"{file}: is damaged ({flaw}); delete it, or run palpate diagnose again")


def differs_from_fit(saved: float, fitted: float, std_err: float = 0.0) -> bool:
    """Return whether a saved number differs from the result of a repeated fit.

    Args:
        saved: number in the file.
        fitted: number from the repeated fit, in the same unit.
        std_err: standard error of that number; 0 if there is none.
    """
    scale = max(abs(fitted), std_err if isfinite(std_err) else 0.0)
    return not abs(saved - fitted) <= _TOLERANCE * scale


MAX_BYTES = 16_000_000
MAX_TEXT_LENGTH = 4000  # characters
_CHECKSUM = "sha256"  # key of the SHA-256 of the remaining content
Saved = TypeVar("Saved", bound=BaseModel)


def read_saved(file: Path, model: type[Saved]) -> Saved:
    """Read a file that palpate saved, and check its size, form, texts and checksum.

    Args:
        file: path of the file.
        model: pydantic model of its content.

    Raises:
        ValueError: the file is not as palpate wrote it; the message states the reason.
    """
    try:
        if not file.is_file():  # reading a pipe may never end
            raise ValueError("it is not a regular file")
        if file.stat().st_size > MAX_BYTES:
            raise ValueError(f"it has more than {MAX_BYTES // 10**6} MB")
        content = json.loads(file.read_bytes())
        checksum = content.pop(_CHECKSUM, None) if isinstance(content, dict) else None
        saved = model.model_validate_json(json.dumps(content), strict=True)
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError("Invalid JSON") from error
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except OSError as error:
        raise ValueError(f"it cannot be read ({error.strerror})") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(clean_text(str(part)) for part in first["loc"])
        raise ValueError(f"{where}: {first['msg']}" if where else first["msg"]) from error
    for place, text in _texts(saved.model_dump(mode="json")):
        if len(text) > MAX_TEXT_LENGTH:
            raise ValueError(f"{place}: has {len(text)} characters; at most {MAX_TEXT_LENGTH} are allowed")
        if text != clean_text(text):
            raise ValueError(f"{place}: the text {text!a:.60} has characters that cannot be printed")
    if checksum is None:
        raise ValueError(f"{_CHECKSUM}: is missing, as in files of earlier versions")
    if checksum != _checksum(content):
        raise ValueError(f"{_CHECKSUM}: does not match the content, which was changed after palpate wrote it")
    return saved


def with_checksum(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return cleaned content with its checksum, in the form that `read_saved` requires.

    Args:
        content: content to be saved as JSON.
    """
    cleaned = clean_texts(content)
    return {**cleaned, _CHECKSUM: _checksum(cleaned)}


def _checksum(content: Mapping[str, Any]) -> str:
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def clean_texts(content: Any) -> Any:  # noqa: ANN401, whatever JSON can hold
    """Return the content with texts in the form that `read_saved` accepts.

    Args:
        content: content that JSON can represent.
    """
    if isinstance(content, str):
        return clean_text(content)[:MAX_TEXT_LENGTH]
    if isinstance(content, Mapping):
        return {clean_texts(key): clean_texts(value) for key, value in content.items()}
    return [clean_texts(value) for value in content] if isinstance(content, list) else content


def clean_text(text: str) -> str:
    """Replace each nonprintable character with a question mark.

    Args:
        text: the text.
    """
    return "".join(char if char.isprintable() else "?" for char in text)


def _texts(content: Any, place: str = "") -> Iterator[tuple[str, str]]:  # noqa: ANN401, whatever JSON can hold
    """Yield the place and the text of each key and string; a key comes before the places that contain it."""
    if isinstance(content, str):
        yield place, content
    elif isinstance(content, Mapping | list):
        for key, value in content.items() if isinstance(content, Mapping) else enumerate(content):
            if isinstance(key, str):
                yield f"a key of {place or 'the file'}", key
            yield from _texts(value, f"{place}.{key}".removeprefix("."))
