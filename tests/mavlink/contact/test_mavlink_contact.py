"""Parts of the connection to a vehicle, each alone: texts, modes, commands, state, malformed bytes."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield_mavlink.contact.exchange import Exchange
from lfield_mavlink.contact.vehicle_state import Texts, VehicleState
from lfield_mavlink.link.dialect import Reader, Writer, dialect, result_text
from lfield_mavlink.modes import ARDUPILOT, PROFILES, PX4
from lfield_mavlink.watchdog import NEEDS


def test_chunks_of_a_status_text_are_joined():
    texts = Texts()
    assert texts.add("short", 0, 0, 1.0) == "short"
    assert texts.add("a" * 50, 7, 0, 2.0) is None
    assert texts.add("b" * 50, 7, 1, 2.0) is None
    assert texts.add("c", 7, 2, 2.5) == "a" * 50 + "b" * 50 + "c"
    assert texts.since(2.0) == ["a" * 50 + "b" * 50 + "c"]
    assert texts.add("a" * 50, 8, 0, 3.0) is None
    assert texts.add("", 8, 1, 3.0) == "a" * 50


def test_status_text_with_a_lost_chunk_is_dropped():
    texts = Texts()
    texts.add("a" * 50, 7, 0, 1.0)
    assert texts.add("c", 7, 2, 1.0) is None
    assert texts.add("tail", 9, 3, 1.0) is None
    assert texts.since(0.0) == []


@given(st.lists(st.tuples(st.text(max_size=50), st.integers(0, 65535), st.integers(0, 255))))
def test_any_sequence_of_text_chunks_uses_bounded_memory(chunks):
    texts = Texts()
    for text, number, sequence in chunks:
        texts.add(text, number, sequence, 0.0)
    assert len(texts._chunks) <= 8
    assert len(texts.since(0.0)) <= 32


def test_result_text_names_the_mav_result():
    assert result_text(4) == "FAILED (4)"
    assert result_text(1) == "TEMPORARILY_REJECTED (1)"
    assert result_text(77) == "unknown result (77)"


def test_mode_names_and_values_of_every_profile():
    copter = PROFILES[ARDUPILOT, "copter"]
    assert copter.mode_name(17) == "BRAKE"
    assert copter.mode_name(99) == "mode 99"
    assert copter.mode_values("BRAKE") == (17.0,)
    assert copter.mode_values("HOVER") is None
    assert PROFILES[PX4, "copter"].mode_values("AUTO.LOITER") == (4.0, 3.0)
    for profile in PROFILES.values():
        names = set(profile.modes.values())
        assert len(names) == len(profile.modes)
        assert {profile.guided, profile.arming, profile.hold, profile.land, profile.home} <= names
        assert profile.own <= names
        assert (profile.autopilot, profile.kind) in NEEDS


class ScriptedExchange:
    """An exchange whose commands are answered by a function."""

    def __init__(self, answers) -> None:
        self.sent: list = []
        self.answers = answers
        self.exchange = Exchange(1, 255, self._send)

    def _send(self, message):
        self.sent.append(message)
        for answer in self.answers(message, len(self.sent)):
            asyncio.get_running_loop().call_soon(self.exchange.on_message, answer)


def ack(number, result, system=255, component=dialect.MAV_COMP_ID_ONBOARD_COMPUTER):
    message = dialect.MAVLink_command_ack_message(number, result, 0, 0, system, component)
    # A packed message has a sender: the autopilot.
    message.pack(dialect.MAVLink(None, srcSystem=1, srcComponent=1))
    return message


def test_unanswered_command_is_repeated_with_higher_confirmation(jumping):
    scripted = ScriptedExchange(lambda message, count: [ack(400, 0)] if count == 3 else [])
    answer = jumping(scripted.exchange.command(400, 1.0))
    assert (answer.result, answer.attempts) == (0, 3)
    assert [m.confirmation for m in scripted.sent] == [0, 1, 2]
    assert all((m.target_system, m.target_component, m.param1) == (1, 1, 1.0) for m in scripted.sent)


def test_command_without_answer_ends_after_two_seconds(jumping):
    scripted = ScriptedExchange(lambda message, count: [])

    async def ask():
        start = asyncio.get_running_loop().time()
        answer = await scripted.exchange.command(400, 1.0)
        return answer.result, asyncio.get_running_loop().time() - start

    result, seconds = jumping(ask())
    assert result is None
    assert seconds == pytest.approx(2.0, abs=0.01)


def test_acknowledgement_with_another_target_is_ignored(jumping):
    others = [ack(400, 0, system=254), ack(400, 0, component=1), ack(22, 0)]
    assert jumping(ScriptedExchange(lambda message, count: others).exchange.command(400)).result is None
    assert (
        jumping(
            ScriptedExchange(lambda m, c: [ack(400, 0, system=0, component=0)]).exchange.command(400)
        ).result
        == 0
    )


def test_result_in_progress_extends_the_wait(jumping):
    scripted = ScriptedExchange(lambda message, count: [ack(400, 5)])

    async def ask():
        asyncio.get_running_loop().call_later(4.0, scripted.exchange.on_message, ack(400, 0))
        return await scripted.exchange.command(400)

    answer = jumping(ask())
    assert (answer.result, answer.attempts) == (0, 1)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.binary(max_size=80), max_size=5))
def test_malformed_bytes_do_not_raise_or_hide_later_packets(pieces):
    reader, state = Reader(), VehicleState("copter")
    for piece in pieces:
        for message in reader.feed(piece):
            state.update(message, 1.0)
    packet = Writer().pack(dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3), 1)
    # A false header may consume the bytes of a whole packet before its checksum fails.
    for _ in range(20):
        for message in reader.feed(packet):
            state.update(message, 2.0)
    assert state.mode == "GUIDED"
    assert state.armed


floats = st.floats(width=32)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(floats, min_size=6, max_size=6),
    st.integers(-128, 127),
    st.integers(0, 0xFFFF),
    st.integers(0, 255),
)
def test_telemetry_outside_its_range_is_not_published(numbers, percent, volts, landed):
    state = VehicleState("copter")
    values: dict = {}
    for message in (
        dialect.MAVLink_local_position_ned_message(0, *numbers),
        dialect.MAVLink_attitude_message(0, *numbers),
        dialect.MAVLink_sys_status_message(0, 0, 0, 0, volts, 0, percent, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_extended_sys_state_message(0, landed),
    ):
        values |= state.update(message, 1.0)
    assert 0.0 <= values.get("battery", 0.0) <= 1.0
    assert "altitude" not in values or abs(values["altitude"]) < float("inf")


@pytest.mark.parametrize(
    ("kind", "actions"),
    [
        ("copter", {}),
        ("rover", {"land": "hold"}),
        ("plane", {"land": "return"}),
        ("submarine", {"land": "surface", "return": "surface"}),
    ],
)
def test_safe_action_names_what_each_vehicle_kind_does(kind, actions):
    profile = PROFILES[ARDUPILOT, kind]
    found = {state: profile.safe_action(state) for state in ("land", "hold", "return")}
    assert {state: action for state, action in found.items() if action != state} == actions
