"""The bytes of orders as datagrams: bounds, and invalid orders."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.errors import WireError
from lfield.wire.order_messages import (
    MAGIC,
    MAX_DATAGRAM,
    Epochs,
    Order,
    OrderTarget,
    SignedAnswer,
    decode_answer,
    decode_datagram,
    decode_order,
    devices_of,
    encode_datagram,
    encode_part,
    order_confirmation,
    short_reason,
)

ID = bytes(range(16))


def signed(answer: bytes, certificate: int) -> SignedAnswer:
    return SignedAnswer(answer, bytes(16), bytes(64), bytes(certificate))


@given(
    st.dictionaries(st.text(min_size=1, max_size=40), st.text(max_size=300), max_size=80),
    st.text(max_size=500),
)
def test_a_confirmation_fits_with_a_certificate_and_counts_omitted_devices(devices, trouble):
    answer = order_confirmation(ID, Epochs(), devices, trouble)
    assert len(encode_datagram(signed(encode_part(answer), 490))) <= MAX_DATAGRAM
    devices_in_answer = devices_of(answer)
    assert len(devices_in_answer) + answer.more == len(devices)
    assert {name for name, reason in devices_in_answer.items() if reason} <= {
        name for name, reason in devices.items() if reason
    }
    assert decode_answer(encode_part(answer)) == answer


def test_unsafe_devices_are_reported_first():
    devices = {f"arm{number}.fc": "" for number in range(100)} | {"zulu.fc": "it does not answer"}
    answer = order_confirmation(ID, Epochs(), devices, "")
    assert answer.unsafe == {"zulu.fc": "it does not answer"}
    assert answer.more > 0


@given(st.text(max_size=400))
def test_a_reason_is_cut_between_characters(text):
    reason = short_reason(text)
    assert len(reason.encode()) <= 160
    assert text.startswith(reason) or "?" in reason


def test_an_order_that_names_a_host_twice_is_refused():
    order = Order("stop", ID, "", (OrderTarget("alpha", bytes(8)), OrderTarget("alpha", b"x" * 8)))
    with pytest.raises(WireError, match="twice"):
        decode_order(encode_part(order))


@given(st.binary(max_size=MAX_DATAGRAM + 8))
def test_any_bytes_are_a_datagram_or_a_wire_error(data):
    for given_bytes in (data, MAGIC + data):
        try:
            decode_datagram(given_bytes)
            decode_order(data)
        except WireError:
            continue


def test_a_datagram_that_is_too_large_is_not_made():
    with pytest.raises(WireError, match="does not fit"):
        encode_datagram(signed(bytes(600), 600))
