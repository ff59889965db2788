import threading
import time

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robot_io.session.shared_log import RingBuffer

DTYPE = np.dtype([("a", "<i8"), ("b", "<f8", (30,))])


def ring_of(slots):
    return RingBuffer(memoryview(bytearray(RingBuffer.size_bytes(DTYPE, slots))), DTYPE, slots)


def record(number):
    return (number, np.full(30, number))


@given(
    st.integers(1, 7), st.lists(st.tuples(st.sampled_from(["push", "pop"]), st.integers(1, 9)), max_size=60)
)
def test_it_is_a_queue_that_counts_what_it_cannot_hold(slots, steps):
    ring, model, offered, dropped = ring_of(slots), [], 0, 0
    for step, count in steps:
        if step == "push":
            for _ in range(count):
                if len(model) < slots:
                    model.append(offered)
                else:
                    dropped += 1
                ring.push(record(offered))
                offered += 1
        else:
            taken = []
            while len(taken) < count and (got := ring.pop(count - len(taken)))[1].size:
                np.testing.assert_array_equal(got[0], got[1]["a"])
                taken += got[1]["a"].tolist()
            assert taken == model[:count]
            del model[:count]
        assert (ring.dropped, ring.offered, ring.full) == (dropped, offered, len(model) == slots)


def test_a_record_of_the_wrong_form_leaves_no_trace():
    ring = ring_of(4)
    ring.push(record(0))
    for wrong in [(1,), (1, np.zeros(29)), ("x", np.zeros(30))]:
        try:
            ring.push(wrong)
        except (TypeError, ValueError):
            continue
        raise AssertionError(f"{wrong} was taken")
    ring.push(record(1))
    assert ring.pop(9)[1]["a"].tolist() == [0, 1]
    assert ring.dropped == 0


def test_records_are_whole_while_both_sides_are_busy():
    memory, slots, count = bytearray(RingBuffer.size_bytes(DTYPE, 8)), 8, 1_000
    incoming, ring = (RingBuffer(memoryview(memory), DTYPE, slots) for _ in range(2))

    def produce():
        for number in range(count):
            while incoming.full:
                time.sleep(0)
            incoming.push(record(number))

    producer = threading.Thread(target=produce)
    producer.start()
    sequences = []
    while producer.is_alive() or ring.taken < ring.offered:
        sequence, records = ring.pop(5)
        np.testing.assert_array_equal(
            records["b"], np.broadcast_to(records["a"][:, None], records["b"].shape)
        )
        np.testing.assert_array_equal(sequence, records["a"])
        sequences += sequence.tolist()
    assert sequences == list(range(count))
    assert ring.dropped == 0
