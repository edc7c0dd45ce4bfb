"""Parameters: both encodings exact, requests bounded, lists without gaps."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted_peer import Channel, run

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_mavlink.services.autopilot_version import encoding_of
from lfield_mavlink.services.parameter_values import Encoding, decode, encode
from lfield_mavlink.services.parameters import Parameters

REAL, INT8, UINT8, INT16, UINT16, INT32, UINT32 = 9, 2, 1, 4, 3, 6, 5
RANGES = {
    INT8: (-(2**7), 2**7 - 1),
    UINT8: (0, 2**8 - 1),
    INT16: (-(2**15), 2**15 - 1),
    UINT16: (0, 2**16 - 1),
    INT32: (-(2**31), 2**31 - 1),
    UINT32: (0, 2**32 - 1),
}


class Autopilot:
    """Parameters with their types, encoded byte for byte; those in `refuses` keep their values."""

    def __init__(self, encoding: Encoding, values: dict[str, tuple[float, int]]) -> None:
        self.encoding, self.values = encoding, values
        self.refuses: set[str] = set()
        self.listed = 0

    def __call__(self, message):
        name = message.get_type()
        if name == "PARAM_REQUEST_READ":
            requests = (
                message.param_id if message.param_index < 0 else sorted(self.values)[message.param_index]
            )
            return [self.value(requests)] if requests in self.values else []
        if name == "PARAM_REQUEST_LIST":
            self.listed += 1
            return [self.value(each) for each in sorted(self.values)]
        if name == "PARAM_SET" and message.param_id in self.values:
            if message.param_id not in self.refuses:
                raw = bytes(message.get_msgbuf()[10:14])
                kind = self.values[message.param_id][1]
                assert message.param_type == kind
                self.values[message.param_id] = (decode(raw, kind, self.encoding), kind)
            return [self.value(message.param_id)]
        return []

    def value(self, name):
        value, kind = self.values[name]
        raw = encode(value, kind, self.encoding)
        message = dialect.MAVLink_param_value_message(
            name.encode(), raw, kind, len(self.values), sorted(self.values).index(name)
        )
        # Sends the four bytes unchanged.
        message.unpacker = struct.Struct("<4sHH16sB")
        return message


def joined(autopilot, **faults):
    channel = Channel(autopilot, **faults)

    async def encoding():
        return autopilot.encoding

    return channel, Parameters(channel, encoding)


@pytest.mark.parametrize("encoding", list(Encoding))
def test_parameters_are_read_and_written_in_both_encodings(encoding):
    autopilot = Autopilot(encoding, {"SPEED": (2.5, REAL), "COUNT_OF_SIXTEEN": (-7, INT8)})
    _, parameters = joined(autopilot)

    async def scenario():
        before = (await parameters.read("SPEED"), await parameters.read("COUNT_OF_SIXTEEN"))
        await parameters.write("SPEED", 0.1)
        await parameters.write("COUNT_OF_SIXTEEN", 12)
        return before, await parameters.read("SPEED"), await parameters.read("COUNT_OF_SIXTEEN")

    before, speed, count = run(scenario(), 5.0)
    assert before == (2.5, -7)
    assert speed == pytest.approx(0.1)
    assert (count, type(count)) == (12, int)


def test_integer_that_a_float_would_change_is_exact():
    # As float bytes this is a signalling NaN, which a conversion changes.
    tricky = -8388607
    autopilot = Autopilot(Encoding.BYTEWISE, {"ID": (0, INT32)})
    _, parameters = joined(autopilot)

    async def scenario():
        await parameters.write("ID", tricky)
        return await parameters.read("ID")

    assert run(scenario(), 5.0) == tricky
    assert autopilot.values["ID"] == (tricky, INT32)


def test_unknown_parameter_gives_none_within_three_seconds():
    channel, parameters = joined(Autopilot(Encoding.CAST, {}))
    assert run(parameters.read("NOPE"), 3.01) is None
    assert len(channel.sent) == 15
    with pytest.raises(DeviceError, match="no answer about a parameter NOPE in 3 s"):
        run(parameters.write("NOPE", 1.0), 3.01)


@pytest.mark.parametrize("name", ["", "SEVENTEEN_LETTERS", "ÄTHER", "A\nB"])
def test_invalid_parameter_name_is_refused_before_sending(name):
    channel, parameters = joined(Autopilot(Encoding.CAST, {}))
    with pytest.raises(DeviceError, match="is not a parameter name"):
        run(parameters.read(name))
    assert channel.sent == []


def test_value_refused_by_the_autopilot_is_an_error():
    autopilot = Autopilot(Encoding.CAST, {"MODE": (3, INT8)})
    autopilot.refuses = {"MODE"}
    _, parameters = joined(autopilot)
    with pytest.raises(DeviceError, match="MODE could not be set to 5: it is 3"):
        run(parameters.write("MODE", 5), 4.0)


@pytest.mark.parametrize("seed", range(20))
def test_lost_answer_is_requested_again(seed):
    autopilot = Autopilot(Encoding.CAST, {"MODE": (3, INT8)})
    _, parameters = joined(autopilot, seed=seed, loss=0.3, repeat=0.3, overtake=0.3)
    run(parameters.write("MODE", 5), 10.0)
    assert autopilot.values["MODE"] == (5, INT8)


def test_parameter_list_with_losses_is_complete():
    values = {f"P{number}": (number / 2, REAL) for number in range(300)}
    autopilot = Autopilot(Encoding.CAST, values)
    channel, parameters = joined(autopilot, seed=3, loss=0.3, repeat=0.1, overtake=0.1)
    found = run(parameters.read_all(), 60.0)
    assert found == {name: value for name, (value, _) in values.items()}
    # The gaps were requested one by one, not the list again.
    assert autopilot.listed <= 3
    assert channel.kinds().count("PARAM_REQUEST_READ") > 50


def test_incomplete_parameter_list_is_an_error():
    autopilot = Autopilot(Encoding.CAST, {"A": (1.0, REAL), "B": (2.0, REAL)})

    def half(message):
        return [m for m in autopilot(message) if m.param_id == "A"]

    channel = Channel(half)

    async def encoding():
        return Encoding.CAST

    with pytest.raises(DeviceError, match="received 1 of 2 parameters"):
        run(Parameters(channel, encoding).read_all(), 10.0)


@given(st.sampled_from(list(RANGES)), st.data(), st.sampled_from(list(Encoding)))
def test_integer_encoding_is_exact_or_refused(kind, data, encoding):
    value = data.draw(st.integers(*RANGES[kind]))
    exact_in_float = struct.unpack("<f", struct.pack("<f", value))[0] == value
    if encoding is Encoding.CAST and not exact_in_float:
        with pytest.raises(ValueError, match="exactly"):
            encode(value, kind, encoding)
    else:
        assert decode(encode(value, kind, encoding), kind, encoding) == value


@given(st.floats(width=32, allow_nan=False, allow_infinity=False), st.sampled_from(list(Encoding)))
def test_float_encoding_is_exact(value, encoding):
    assert decode(encode(value, REAL, encoding), REAL, encoding) == value


@given(st.binary(min_size=4, max_size=4), st.integers(0, 255), st.sampled_from(list(Encoding)))
def test_any_four_bytes_are_decoded_or_rejected(raw, kind, encoding):
    value = decode(raw, kind, encoding)
    assert value is None or isinstance(value, int | float)


@pytest.mark.parametrize(
    ("value", "kind", "words"),
    [
        (math.nan, REAL, "not a value"),
        (math.inf, INT8, "not a value"),
        (1.5, INT8, "integer"),
        (200, INT8, "range of its 8 bits"),
        (-1, UINT32, "range of its 32 bits"),
        (1e300, REAL, "32-bit float"),
        (2**24 + 1, INT32, "cannot be sent exactly"),
    ],
)
def test_value_outside_its_type_is_refused(value, kind, words):
    with pytest.raises(ValueError, match=words):
        encode(value, kind, Encoding.CAST)


@pytest.mark.parametrize(
    ("autopilot", "capabilities", "encoding"),
    [
        (3, 0xFBEF, Encoding.CAST),  # as ArduPilot 4.7 reports: neither
        (3, 0x20000, Encoding.CAST),
        (3, 0x10, Encoding.BYTEWISE),
        (12, 0, Encoding.BYTEWISE),
        (12, 0x20000, Encoding.CAST),
    ],
)
def test_encoding_by_autopilot_and_capabilities(autopilot, capabilities, encoding):
    assert encoding_of(autopilot, capabilities) is encoding


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=16), st.binary(min_size=4, max_size=4), st.integers(0, 255))
def test_any_parameter_message_is_survived_by_a_read(name, raw, kind):
    message = dialect.MAVLink_param_value_message(name, raw, kind, 1, 0)
    message.unpacker = struct.Struct("<4sHH16sB")
    channel, parameters = joined(Autopilot(Encoding.CAST, {}))
    channel.vehicle = lambda _: [message]
    run(parameters.read("X"), 4.0)
    assert list(Reader().feed(message.pack(dialect.MAVLink(None))))
