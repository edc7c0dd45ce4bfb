"""The bytes of records: they are restored, and changed bytes are rejected."""

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


@given(page=PAGES, kept=TIMES)
def test_a_record_is_restored(page: Record, kept: float) -> None:
    made = encode_record(page, kept)
    assert decode_record(made) == page
    assert made.key == key_of(page)


@given(page=PAGES, kept=TIMES, data=st.data())
def test_a_record_with_one_wrong_bit_is_rejected(page: Record, kept: float, data: st.DataObject) -> None:
    made = encode_record(page, kept)
    at = data.draw(st.integers(0, 8 * len(made.body) - 1))
    body = bytearray(made.body)
    body[at // 8] ^= 1 << at % 8
    for wrong in (
        made._replace(body=bytes(body)),
        made._replace(written_at=made.written_at + 1.0 + made.written_at / 2),
        made._replace(version=made.version + 1),
        made._replace(key=made.key._replace(number=made.key.number ^ 1)),
        made._replace(key=made.key._replace(name=made.key.name + "x")),
        made._replace(checksum=made.checksum ^ 1),
    ):
        with pytest.raises(RecordError, match="checksum"):
            decode_record(wrong)


ANYTHING = st.sampled_from([None, 0, -1, 2**63, 1.5, float("nan"), 1e300, "copy", b"\xff"])


@given(key=st.builds(RecordKey, ANYTHING, ANYTHING, ANYTHING), rest=st.tuples(*[ANYTHING] * 4))
def test_any_row_in_place_of_a_record_is_rejected_and_described(
    key: RecordKey, rest: tuple[object, ...]
) -> None:
    made = encode_record(StartCounter(1), 0.0)
    found = type(made)(key, *rest)  # type: ignore[arg-type]
    with pytest.raises(RecordError):
        decode_record(found)
    assert describe_loss(found)


def test_a_valid_record_under_another_key_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfield.journal.records.key_of", lambda page: RecordKey("copy", "scout", 1))
    made = encode_record(StartCounter(1), 0.0)
    monkeypatch.undo()
    with pytest.raises(RecordError, match="stored under another key"):
        decode_record(made)


def test_a_record_of_a_newer_version_is_distinguished_from_a_damaged_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("lfield.journal.records.VERSION", VERSION + 1)
    made = encode_record(StartCounter(1), 0.0)
    monkeypatch.undo()
    with pytest.raises(UnsupportedRecordVersion, match=f"version {VERSION + 1}"):
        decode_record(made)
