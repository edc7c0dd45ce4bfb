"""Counters and checksums: recorded frames, the values of AUTOSAR's specification, and foreign libraries."""

from __future__ import annotations

import pytest
from cantools.autosar import apply_profile2_crc, apply_profile5_crc
from crccheck.crc import Crc8Autosar, Crc8SaeJ1850
from hypothesis import given
from hypothesis import strategies as st

from lfield_can.bus.frames import Frame
from lfield_can.dbc import DbcError, DbcFile, protections

FILE = """VERSION ""
BU_: X
BO_ 783 Arm: {length} X
 SG_ Check : 0|{bits}@1+ (1,0) [0|0] "" X
 SG_ Counter : {bits}|4@1+ (1,0) [0|0] "" X
 SG_ Angle : {angle}|16@1- (0.1,0) [0|0] "" X
BO_ 2147484577 Honda: 8 X
 SG_ Angle : 7|16@0- (0.1,0) [0|0] "" X
 SG_ Counter : 61|2@0+ (1,0) [0|3] "" X
 SG_ Check : 59|4@0+ (1,0) [0|15] "" X
 SG_ Gain : 16|32@1- (1,0) [0|0] "" X
SIG_VALTYPE_ 2147484577 Gain : 1;
"""
#: Frames of a Volkswagen, as recorded for opendbc: E2E profile 2, here with one data id for all counters.
RECORDED = {
    0x0C: ("1000100000000000", "7401100000000000", "fe0c100000000000", "520f100000000000"),
    0x27: ("ba00000000000010", "de01000000000010", "470b000000000010", "4405000000000000"),
}


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The protection of a message with a checksum in its first bytes."""

    def make(checksum, *, length=8, bits=8, counters=("Arm.Counter",)):
        path = tmp_path_factory.mktemp("dbc") / "arm.dbc"
        path.write_text(FILE.format(length=length, bits=bits, angle=bits + 8))
        return protections(DbcFile(str(path)), counters, [checksum])

    return make


def same_ids(number):
    return " ".join([str(number)] * 16)


@pytest.mark.parametrize(("number", "text"), [(n, text) for n, texts in RECORDED.items() for text in texts])
def test_recorded_frames_are_valid_and_changed_frames_are_not(arm, number, text):
    data = bytes.fromhex(text)
    protection = arm(f"Arm.Check=e2e_2 {same_ids(number)}")["Arm"]
    assert protection.problem(data) == ""
    assert "checksum Check is" in protection.problem(data[:7] + bytes([data[7] ^ 1]))


@pytest.mark.parametrize(
    ("checksum", "first"),
    [
        # The examples of the specification, with data of zeros.
        ("Arm.Check=e2e_1 0x123", ("cc00000000000000", "9101000000000000")),
        ("Arm.Check=xor8", ("0000000000000000", "0101000000000000")),
        ("Arm.Check=sum8", ("0000000000000000", "0101000000000000")),
        ("Arm.Check=toyota", ("1a00000000000000", "1b01000000000000")),
    ],
)
def test_sent_frames_carry_the_next_counter_and_its_checksum(arm, checksum, first):
    protection = arm(checksum, counters=("Arm.Counter=15",))["Arm"]
    sent = [protection.protected(bytes(8)) for _ in range(16)]
    assert [frame.hex() for frame in sent[:2]] == list(first)
    assert [frame[1] & 0xF for frame in sent] == [*range(15), 0]
    receiver = arm(checksum, counters=("Arm.Counter=15",))["Arm"]
    assert [receiver.problem(frame) for frame in sent] == [""] * 16
    assert receiver.problem(sent[-1]) == "counter Counter is not incremented"


@given(st.binary(min_size=7, max_size=7), st.lists(st.integers(0, 255), min_size=16, max_size=16))
def test_checksums_equal_those_of_foreign_libraries(arm, rest, ids):
    data = b"\0" + rest
    listed = ",".join(map(str, ids))
    counter = rest[0] & 0xF
    protection = arm(f"Arm.Check=e2e_2 {listed}")["Arm"]
    assert protection.problem(bytes(apply_profile2_crc(data, ids[counter]))) == ""
    for kind, foreign in (("crc8_j1850", Crc8SaeJ1850), ("crc8_h2f", Crc8Autosar)):
        right = bytes([foreign.calc(rest)]) + rest
        assert arm(f"Arm.Check={kind}")["Arm"].problem(right) == ""


def test_e2e_profile_5_protects_a_can_fd_frame(arm):
    protection = arm("Arm.Check=e2e_5 0xBEEF", length=64, bits=16)["Arm"]
    sent = [protection.protected(bytes(range(64))) for _ in range(3)]
    assert sent == [bytes(apply_profile5_crc(frame, 0xBEEF)) for frame in sent]
    assert [frame[2] & 0xF for frame in sent] == [0, 1, 2]


def test_honda_checksum_of_a_motorola_nibble(arm):
    """The checksums of opendbc's LKAS_HUD decrease by one while the counter increases."""
    protection = arm("Honda.Check=honda", counters=["Honda.Counter"])["Honda"]
    sums = [protection.protected(bytes.fromhex("4100000000000000"))[7] & 0xF for _ in range(4)]
    assert [(sums[0] - each) % 16 for each in sums] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("counters", "checksum", "words"),
    [
        ((), "Arm.Check", "does not have the form Message.Signal=KIND"),
        ((), "Arm.Check=md5", "kinds are xor8, sum8"),
        ((), "Arm.Nothing=xor8", "no signal 'Nothing'"),
        ((), "Arm.Counter=xor8", "has 4 bits; the checksum xor8 has 8"),
        ((), "Arm.Angle=e2e_5 1", "cannot be a checksum"),
        ((), "Arm.Check=e2e_1", "requires 1 data ids, not 0"),
        ((), "Arm.Check=e2e_1 0x10000", "does not have the form"),
        ((), "Arm.Check=e2e_1 99999", "at most 0xFFFF"),
        ((), f"Arm.Check=e2e_2 {same_ids(3)}", "selects its data id by the counter"),
        (("Arm.Counter",), f"Arm.Check=e2e_2 {same_ids(256)}", "at most 0xFF"),
        (("Arm.Counter=17",), "Arm.Check=xor8", "has 2 to 16 values, not 17"),
        (("Arm.Counter=0",), "Arm.Check=xor8", "has 2 to 16 values"),
        (("Counter",), "Arm.Check=xor8", "does not have the form Message.Counter"),
        (("Honda.Gain",), "Arm.Check=xor8", "cannot be a counter"),
    ],
)
def test_invalid_counter_or_checksum_option_is_refused(arm, counters, checksum, words):
    with pytest.raises(DbcError, match=words):
        arm(checksum, counters=counters)


@given(st.binary(max_size=64))
def test_any_frame_is_valid_or_has_a_reason(arm, data):
    protection = arm("Arm.Check=e2e_1 1")["Arm"]
    assert isinstance(protection.problem(Frame(783, data).data), str)
