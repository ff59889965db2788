"""A diagnosis in its file: read again only for the very data and base models that it is about."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from estimation.diagnosis import ChannelDiagnosis, Diagnosis
from estimation.study.channels import StudyChannel
from robot_io.errors import InputError

RESULT = "diagnosis.json"
_ABOUT = "judged"  # key under which the file says what data and base models it is about


def diagnosis_data(diagnosis: Diagnosis, channels: Sequence[StudyChannel]) -> dict[str, Any]:
    """A diagnosis as plain data; the keys are stable."""
    about = {one.name: {"model": one.model.name, "data_sha256": one.sha256} for one in channels}
    return diagnosis.model_dump(mode="json") | {_ABOUT: about}


def read_diagnosis(folder: Path | None) -> dict[tuple[str, str, str], ChannelDiagnosis]:
    """What a file says, by channel, base model and hash of the data; nothing where there is none.

    Raises:
        InputError: the file is damaged.
    """
    file = None if folder is None else folder / RESULT
    if file is None or not file.is_file():
        return {}
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        about = content.pop(_ABOUT)
        found = Diagnosis.model_validate(content)
        return {
            (one.channel, about[one.channel]["model"], about[one.channel]["data_sha256"]): one
            for one in found.channels
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ValidationError) as error:
        raise InputError(f"{file}: is damaged; delete it, or run palpate diagnose again") from error
