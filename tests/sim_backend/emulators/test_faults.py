"""Faults occur at the planned device, time and count."""

import pytest

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import validate
from palpate.sim_backend.emulators import Fault, FaultKind, Faults


def hits(faults, kind=FaultKind.DROP, device=1, times_s=range(10)):
    return [time_s for time_s in times_s if faults.trigger(kind, device, time_s)]


def test_fault_is_limited_to_its_window_device_and_count():
    assert hits(Faults()) == []
    faults = Faults([Fault(kind=FaultKind.DROP, from_s=2, for_s=3)], start_s=1)
    assert hits(faults) == [3, 4, 5]
    faults = Faults([Fault(kind=FaultKind.DROP, device=2), Fault(kind=FaultKind.STUCK)])
    assert hits(faults, device=1) == []
    assert len(hits(faults, device=2)) == 10
    assert len(hits(faults, FaultKind.STUCK, "force")) == 10
    faults = Faults([Fault(kind=FaultKind.DROP, times=3)])
    assert hits(faults) == [0, 1, 2]
    faults.add(Fault(kind=FaultKind.DROP, times=1))
    assert hits(faults) == [0]
    faults.clear()
    assert hits(faults) == []


def test_fault_probability_is_repeatable_and_calibrated():
    def misfortunes(seed):
        return hits(Faults([Fault(kind=FaultKind.DROP, probability=0.3)], seed=seed), times_s=range(2000))

    assert misfortunes(1) == misfortunes(1)
    assert misfortunes(1) != misfortunes(2)
    assert len(misfortunes(1)) == pytest.approx(600, abs=80)


def test_one_bit_is_flipped():
    faults, frame = Faults(seed=3), bytes(range(20))
    for _ in range(200):
        changed = faults.flip_a_bit(frame)
        difference = [a ^ b for a, b in zip(frame, changed, strict=True)]
        assert sum(value.bit_count() for value in difference) == 1


@pytest.mark.parametrize(
    ("data", "what"),
    [
        ({"kind": "drops"}, "drop"),
        ({"kind": "drop", "form_s": 1}, "from_s"),
        ({"kind": "drop", "times": 0}, "times"),
        ({"kind": "drop", "probability": 2}, "probability"),
        ({"kind": "drop", "for_s": -1}, "for_s"),
    ],
)
def test_invalid_fault_is_refused(data, what):
    with pytest.raises(InputError, match=what):
        validate(Fault, data)
