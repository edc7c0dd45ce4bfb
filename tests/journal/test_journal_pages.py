"""Records as bytes: decoding restores them, and rejects changed bytes."""

from __future__ import annotations

from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.journal.journal_loader import describe_loss
from lfield.journal.records import (
    VERSION,
    CoordinatorRecord,
    EmergencyStopFlag,
    FenceRecord,
    PauseFlag,
    PendingCallRecord,
    ProgramRecord,
    Record,
    RecordError,
    RecordKey,
    ReservationRecord,
    RunMarker,
    StartCounter,
    StoredState,
    UnsupportedRecordVersion,
    decode_record,
    encode_record,
    key_of,
)
from lfield.wire.coordinator_messages import Outcome

COUNTS = st.integers(0, 2**63 - 1)
WORDS = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
HASHES = st.binary(max_size=32)
PAGES: st.SearchStrategy[Record] = st.one_of(
    st.builds(
        CoordinatorRecord,
        WORDS,
        COUNTS,
        st.sampled_from(get_args(StoredState)),
        *(COUNTS, COUNTS, WORDS, WORDS, WORDS, COUNTS),
        st.sampled_from(["", *get_args(Outcome)]),
        *(WORDS, WORDS, HASHES, st.binary(max_size=200), WORDS),
    ),
    st.builds(
        PendingCallRecord,
        *(WORDS, COUNTS, COUNTS, WORDS, WORDS),
        st.sampled_from(["", "done", "thrown"]),
        *(st.binary(max_size=200), HASHES),
    ),
    st.builds(StartCounter, COUNTS),
    st.builds(RunMarker, st.booleans()),
    st.builds(PauseFlag, st.booleans()),
    st.builds(EmergencyStopFlag, WORDS),
    st.builds(FenceRecord, WORDS, COUNTS),
    st.builds(ReservationRecord, WORDS, COUNTS, WORDS, COUNTS),
    st.builds(
        ProgramRecord, HASHES, st.binary(max_size=200), st.tuples(WORDS), st.tuples(WORDS), st.tuples()
    ),
)
TIMES = st.floats(0, 4e9)


@given(page=PAGES, time=TIMES)
def test_a_record_is_restored(page: Record, time: float) -> None:
    encoded = encode_record(page, time)
    assert decode_record(encoded) == page
    assert encoded.key == key_of(page)


@given(page=PAGES, time=TIMES, data=st.data())
def test_a_record_with_one_wrong_bit_is_rejected(page: Record, time: float, data: st.DataObject) -> None:
    encoded = encode_record(page, time)
    at = data.draw(st.integers(0, 8 * len(encoded.body) - 1))
    body = bytearray(encoded.body)
    body[at // 8] ^= 1 << at % 8
    for damaged in (
        encoded._replace(body=bytes(body)),
        encoded._replace(written_at=encoded.written_at + 1.0 + encoded.written_at / 2),
        encoded._replace(version=encoded.version + 1),
        encoded._replace(key=encoded.key._replace(number=encoded.key.number ^ 1)),
        encoded._replace(key=encoded.key._replace(name=encoded.key.name + "x")),
        encoded._replace(checksum=encoded.checksum ^ 1),
    ):
        with pytest.raises(RecordError, match="checksum"):
            decode_record(damaged)


ANY_VALUE = st.sampled_from([None, 0, -1, 2**63, 1.5, float("nan"), 1e300, "copy", b"\xff"])


@given(key=st.builds(RecordKey, ANY_VALUE, ANY_VALUE, ANY_VALUE), rest=st.tuples(*[ANY_VALUE] * 4))
def test_any_row_in_place_of_a_record_is_rejected_and_described(
    key: RecordKey, rest: tuple[object, ...]
) -> None:
    encoded = encode_record(StartCounter(1), 0.0)
    row = type(encoded)(key, *rest)  # type: ignore[arg-type]
    with pytest.raises(RecordError):
        decode_record(row)
    assert describe_loss(row)


def test_a_valid_record_under_another_key_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfield.journal.records.key_of", lambda page: RecordKey("copy", "scout", 1))
    encoded = encode_record(StartCounter(1), 0.0)
    monkeypatch.undo()
    with pytest.raises(RecordError, match="stored under another key"):
        decode_record(encoded)


def test_a_record_of_a_newer_version_is_distinguished_from_a_damaged_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("lfield.journal.records.VERSION", VERSION + 1)
    encoded = encode_record(StartCounter(1), 0.0)
    monkeypatch.undo()
    with pytest.raises(UnsupportedRecordVersion, match=f"version {VERSION + 1}"):
        decode_record(encoded)
