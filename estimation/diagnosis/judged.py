"""A channel that was judged."""

from dataclasses import dataclass

from estimation.channel import ChannelData
from estimation.diagnosis.result import ChannelDiagnosis
from estimation.model import Model


@dataclass(frozen=True)
class Judged:
    """A channel with its base model and what was found out about it.

    Attributes:
        data: as it was judged, which need not be as it was recorded, see `with_true_force`.
        model: the base model.
        found: the answer.
        borne_out: of a contact that is not explained in full, whether the joints bear out the fault of its
            sensor that it names.
    """

    data: ChannelData
    model: Model
    found: ChannelDiagnosis
    borne_out: bool = False
