"""The bytes of pages: what is written is read, and what was changed on the way is not believed."""

from __future__ import annotations

from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.journal.opening import lost
from lfield.journal.pages import (
    VERSION,
    BegunPage,
    CopyPage,
    Fence,
    KeptState,
    Key,
    NewerPage,
    Page,
    PageError,
    Paused,
    ProgramPage,
    ReservationPage,
    Run,
    Starts,
    Stopped,
    entry,
    key_of,
    page_of,
)
from lfield.wire.coordinators import Outcome

COUNTS = st.integers(0, 2**63 - 1)
WORDS = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
HASHES = st.binary(max_size=32)
PAGES: st.SearchStrategy[Page] = st.one_of(
    st.builds(
        CopyPage,
        WORDS,
        COUNTS,
        st.sampled_from(get_args(KeptState)),
        *(COUNTS, COUNTS, WORDS, WORDS, WORDS, COUNTS),
        st.sampled_from(["", *get_args(Outcome)]),
        *(WORDS, WORDS, HASHES, st.binary(max_size=200), WORDS),
    ),
    st.builds(
        BegunPage,
        *(WORDS, COUNTS, COUNTS, WORDS, WORDS),
        st.sampled_from(["", "done", "thrown"]),
        *(st.binary(max_size=200), HASHES),
    ),
    st.builds(Starts, COUNTS),
    st.builds(Run, st.booleans()),
    st.builds(Paused, st.booleans()),
    st.builds(Stopped, WORDS),
    st.builds(Fence, WORDS, COUNTS),
    st.builds(ReservationPage, WORDS, COUNTS, WORDS, COUNTS),
    st.builds(ProgramPage, HASHES, st.binary(max_size=200), st.tuples(WORDS), st.tuples(WORDS), st.tuples()),
)
TIMES = st.floats(0, 4e9)


@given(page=PAGES, kept=TIMES)
def test_a_page_is_read_as_it_was_written(page: Page, kept: float) -> None:
    made = entry(page, kept)
    assert page_of(made) == page
    assert made.key == key_of(page)


@given(page=PAGES, kept=TIMES, data=st.data())
def test_a_page_with_one_bit_that_is_wrong_is_not_believed(
    page: Page, kept: float, data: st.DataObject
) -> None:
    made = entry(page, kept)
    at = data.draw(st.integers(0, 8 * len(made.body) - 1))
    body = bytearray(made.body)
    body[at // 8] ^= 1 << at % 8
    for wrong in (
        made._replace(body=bytes(body)),
        made._replace(kept=made.kept + 1.0 + made.kept / 2),
        made._replace(version=made.version + 1),
        made._replace(key=made.key._replace(number=made.key.number ^ 1)),
        made._replace(key=made.key._replace(name=made.key.name + "x")),
        made._replace(check=made.check ^ 1),
    ):
        with pytest.raises(PageError, match="checksum"):
            page_of(wrong)


ANYTHING = st.sampled_from([None, 0, -1, 2**63, 1.5, float("nan"), 1e300, "copy", b"\xff"])


@given(key=st.builds(Key, ANYTHING, ANYTHING, ANYTHING), rest=st.tuples(*[ANYTHING] * 4))
def test_anything_in_the_place_of_a_page_is_a_damaged_one_and_can_be_told(
    key: Key, rest: tuple[object, ...]
) -> None:
    made = entry(Starts(1), 0.0)
    found = type(made)(key, *rest)  # type: ignore[arg-type]
    with pytest.raises(PageError):
        page_of(found)
    assert lost(found)


def test_a_sound_page_in_the_place_of_another_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfield.journal.pages.key_of", lambda page: Key("copy", "scout", 1))
    made = entry(Starts(1), 0.0)
    monkeypatch.undo()
    with pytest.raises(PageError, match="the place of another"):
        page_of(made)


def test_a_page_of_a_newer_version_is_told_from_a_damaged_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfield.journal.pages.VERSION", VERSION + 1)
    made = entry(Starts(1), 0.0)
    monkeypatch.undo()
    with pytest.raises(NewerPage, match=f"version {VERSION + 1}"):
        page_of(made)
