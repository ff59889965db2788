"""A diagnosis in its file: read again only for the very data and base models that it is about."""

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from estimation.diagnosis import ChannelDiagnosis, Diagnosis
from estimation.study.channels import StudyChannel
from estimation.study.kept_file import read_kept, with_checksum
from robot_io.errors import InputError

RESULT = "diagnosis.json"
_SAME = 1e-3  # share of a value, or of its standard error, that two fits of the same data may differ by
_ABOUT = "judged"  # key under which the file says what data and base models it is about


class _About(BaseModel):
    """What one channel's diagnosis is about."""

    model: str
    data_sha256: str


class _KeptDiagnosis(Diagnosis):
    """The file."""

    judged: dict[str, _About]


def diagnosis_data(diagnosis: Diagnosis, channels: Sequence[StudyChannel]) -> dict[str, Any]:
    """Return a diagnosis as plain data; the keys are stable.

    Args:
        diagnosis: to save.
        channels: the channels that it is about.
    """
    about = {one.name: {"model": one.model.name, "data_sha256": one.sha256} for one in channels}
    return with_checksum(diagnosis.model_dump(mode="json") | {_ABOUT: about})


def read_diagnosis(folder: Path | None) -> dict[tuple[str, str, str], ChannelDiagnosis]:
    """Read the saved diagnosis of a folder.

    Args:
        folder: of the study; None for none.

    Returns:
        Diagnoses by channel, base model and SHA-256 of the data; empty without a file.

    Raises:
        InputError: the file is damaged.
    """
    file = None if folder is None else folder / RESULT
    if file is None or not file.exists():
        return {}
    try:
        found = read_kept(file, _KeptDiagnosis)
        return {
            (one.channel, found.judged[one.channel].model, found.judged[one.channel].data_sha256): one
            for one in found.channels
        }
    except (ValueError, KeyError) as error:
        why = error if isinstance(error, ValueError) else f"judged.{error}: is missing"
        raise InputError(f"{file}: is damaged ({why}); delete it, or run palpate diagnose again") from error


def is_other(saved: float, fitted: float, std_err: float = 0.0) -> bool:
    """Return whether a saved number differs from that of the same fit, repeated.

    Args:
        saved: number in the file.
        fitted: the same number from a fit, in the same unit.
        std_err: its standard error; 0 for none.
    """
    slack = max(abs(fitted), std_err if isfinite(std_err) else 0.0)
    return not abs(saved - fitted) <= _SAME * slack
