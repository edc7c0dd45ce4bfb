"""Devices of DBC files through the driver, on virtual time; and the file itself, which is pure."""

from __future__ import annotations

import asyncio
import math
import re
from pathlib import Path

import pytest
from coroutine_tests import on_bench
from hypothesis import given
from hypothesis import strategies as st

from lfield.errors import DeviceError
from lfield_can.bus.frames import Frame
from lfield_can.dbc import DbcError, DbcFile

DBC = Path(__file__).with_name("can_demo.dbc")
FILE = DbcFile(str(DBC))
OPTIONS = {
    "dbc": str(DBC),
    "commands": ["Command"],
    "safe": ["Command.speed=0", "Command.valve=100", "Command.gain=1"],
    "confirm": ["Status.speed=0 within 0.2"],
}
DETAIL = FILE.key("Detail") & 0x1FFFFFFF


class Pump:
    """Turns at the commanded speed and reports it ten times a second."""

    def __init__(self, bus) -> None:
        self.bus, self.speed, self.silent, self.deaf = bus, 0.0, False, False
        bus.device = self.on_frame

    def on_frame(self, frame: Frame) -> None:
        if not self.deaf:
            self.speed = FILE.message("Command").decode(frame.data)["speed"]

    async def live(self) -> None:
        while True:
            await asyncio.sleep(0.1)
            if not self.silent:
                data = FILE.message("Status").encode({"speed": self.speed, "heat": 60.0})
                self.bus.say(512, data)


@pytest.fixture
def rig(bench, binding, bus):
    def make(*, waivers=("device_watchdog",), **options):
        pump = Pump(bus)
        bound = binding("CanSignals", field="pump", options={**OPTIONS, **options}, waivers=list(waivers))
        b = bench(bound, bus=bus, fakes=[pump.live])
        b.pump = pump
        return b

    return make


def carried(frame: Frame) -> dict:
    return FILE.message("Command").decode(frame.data)


@on_bench("rig", opened=False)
async def test_identity_names_the_received_messages(b, pump, /):
    assert await pump.open() == "DBC device, received Status"


@on_bench("rig")
async def test_setting_a_signal_keeps_the_others_of_its_message(b, pump, /):
    await pump.execute("set", ["Command.speed", 12.5])
    await pump.execute("set", ["Command.valve", 30.0])
    await asyncio.sleep(2.0)
    assert [carried(frame) for frame in b.bus.sent] == [
        {"speed": 12.5, "valve": 100, "gain": 1.0},
        {"speed": 12.5, "valve": 30, "gain": 1.0},
    ]
    assert await pump.execute("read", ["Status.speed"]) == 12.5
    assert await pump.execute("read", ["Status.heat"]) == 60.0
    await pump.execute("send", ["Command", [1.0, 2.0, 3.0]])
    assert carried(b.bus.sent[-1]) == {"speed": 1.0, "valve": 2, "gain": 3.0}


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            ("set", ["Command.speed", 4000.0]),
            "speed cannot be 4000 rad/s: its range is -3276.8 to 3276.7 rad/s",
        ),
        (("set", ["Command.valve", 101.0]), "valve cannot be 101 %: its range is 0 to 100 %"),
        (("set", ["Command.gain", 1e39]), "gain cannot be 1e"),
        (("set", ["Command.speed", math.nan]), "finite"),
        (
            ("set", ["Status.speed", 1.0]),
            "Status may not be sent: the binding's 'commands' allow only Command",
        ),
        (("set", ["Setup.page", 1.0]), "Setup may not be sent"),
        (("set", ["Command", 1.0]), "does not have the form Message.Signal"),
        (("set", ["Command.spede", 1.0]), "no signal 'spede'; it has speed, valve, gain"),
        (("set", ["Comand.speed", 1.0]), "no message 'Comand'"),
        (("send", ["Command", [1.0]]), r"Command has 3 signals \(speed, valve, gain\), not 1"),
        (("read", ["Nothing.at"]), "no message 'Nothing'"),
    ],
)
@on_bench("rig")
async def test_invalid_signal_is_refused_before_a_frame_is_sent(b, pump, /, call, words):
    with pytest.raises(DeviceError, match=words):
        await pump.execute(*call)
    assert b.bus.sent == []


@on_bench("rig", commands=[], safe=[], confirm=[])
async def test_only_listed_messages_are_sent(b, pump, /):
    with pytest.raises(DeviceError, match="the binding's 'commands' allow nothing"):
        await pump.execute("set", ["Command.speed", 1.0])
    await pump.make_safe()
    assert b.bus.sent == []


@on_bench("rig")
async def test_safe_state_is_sent_confirmed_and_sent_again(b, pump, /):
    await pump.execute("set", ["Command.speed", 12.5])
    await asyncio.sleep(0.5)
    b.pump.deaf = True
    asyncio.get_running_loop().call_later(0.5, setattr, b.pump, "deaf", False)
    await pump.make_safe()
    assert b.pump.speed == 0.0
    b.pump.deaf, b.pump.speed = True, 3.0
    with pytest.raises(DeviceError, match=r"not confirmed: Status.speed is 3.0"):
        await pump.make_safe()


@on_bench("rig")
async def test_safe_state_discards_earlier_values(b, pump, /):
    await pump.execute("set", ["Command.speed", 12.5])
    await pump.make_safe()
    await pump.execute("set", ["Command.valve", 50.0])
    assert carried(b.bus.sent[-1])["speed"] == 0.0


@on_bench("rig")
async def test_device_is_at_rest_while_its_confirmation_matches(b, device, /):
    await device.execute("set", ["Command.speed", 12.5])
    await device.make_safe()
    assert device.moving() == ""
    b.pump.deaf, b.pump.speed = True, 3.0
    await asyncio.sleep(0.3)
    assert device.moving() == "Status.speed is 3.0"
    b.pump.silent = True
    await asyncio.sleep(3.0)
    assert re.fullmatch(r"no message for [23]\.\d s", device.moving()), device.moving()


@on_bench("rig", waivers=("device_watchdog", "no_confirmation"), confirm=[])
async def test_waived_confirmation_means_rest_without_messages(b, device, /):
    await device.make_safe()
    b.pump.silent = True
    await asyncio.sleep(5.0)
    assert device.moving() == ""


@on_bench("rig")
async def test_outdated_value_is_not_read(b, pump, /):
    b.pump.silent = True
    await asyncio.sleep(2.0)
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match=r"Status.speed was not received for over 1 s") as error:
        await pump.execute("read", ["Status.speed"])
    assert error.value.kind == "DeviceTimeoutException"
    assert asyncio.get_running_loop().time() - start == pytest.approx(1.0)
    assert await pump.execute("ageOf", ["Status"]) > 2.5
    assert b.values["online"] is False
    asyncio.get_running_loop().call_later(0.5, setattr, b.pump, "silent", False)
    assert await pump.execute("read", ["Status.speed"]) == 0.0
    await asyncio.sleep(0.2)
    assert carried(b.bus.sent[-1])["speed"] == 0.0  # it returns in its safe state
    assert [note.code for note in b.notes if note.startswith("link ")] == ["can-silent", "can-responding"]


@on_bench("rig")
async def test_multiplexed_message_is_decoded_by_its_page(b, pump, /):
    b.bus.say(DETAIL, bytes([1, 5, 0, 0, 0, 0, 0, 0]), extended=True)
    b.bus.say(DETAIL, bytes([2, 7, 0, 0, 0, 0, 0, 0]), extended=True)
    assert await pump.execute("read", ["Detail.pressure"]) == 50.0
    assert await pump.execute("read", ["Detail.flow"]) == pytest.approx(0.007)
    b.bus.say(DETAIL, bytes([9, 7, 0, 0, 0, 0, 0, 0]), extended=True)
    b.bus.say(DETAIL, bytes(8))  # with an 11-bit id: another message
    await asyncio.sleep(0.2)
    assert b.values["malformed"] == 1


@on_bench(
    "rig",
    commands=["Setup"],
    safe=["Setup.page=1", "Setup.slope=0"],
    confirm=[],
    waivers=["device_watchdog", "no_confirmation"],
)
async def test_setting_a_multiplexed_signal_selects_its_page(b, pump, /):
    await pump.execute("set", ["Setup.limit", 300.0])
    assert b.bus.sent[-1].data == bytes([2, 44, 1, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"dbc": "/nonexistent.dbc"}, "cannot be read"),
        ({"dbc": __file__}, "cannot be read"),
        ({"commands": ["Nothing"], "safe": []}, "'safe' has no value for Nothing"),
        ({"safe": []}, "'safe' has no value for Command, which is among its 'commands'"),
        ({"safe": ["Command.speed=0"]}, "Command cannot be sent without valve, gain"),
        ({"safe": ["Command.speed 0"]}, "does not have the form Message.Signal=VALUE"),
        ({"safe": ["Command.speed=--"]}, "'--' is not a number"),
        ({"safe": ["Status.speed=0"]}, "sends Status, which is not among its 'commands'"),
        ({"safe": [*OPTIONS["safe"][:2], "Command.gain=1e39"]}, "gain cannot be"),
        ({"confirm": []}, r"nothing would confirm that it is safe.*waivers: \[no_confirmation\]"),
        ({"confirm": ["Command.speed=0"]}, "'confirm' requires a message from the device"),
    ],
)
def test_invalid_signal_binding_is_refused(rig, options, words):
    async def mission(pump):
        raise AssertionError("the device must not be opened")

    with pytest.raises(DeviceError, match=words):
        rig(**options).run(mission)


@on_bench("rig", connect=2.0, opened=False)
async def test_absent_dbc_device_is_an_error_within_its_time(b, pump, /):
    b.pump.silent = True
    with pytest.raises(DeviceError, match="none of the messages of its DBC file was received"):
        await pump.open()


@given(st.sampled_from([512, DETAIL, 257]), st.booleans(), st.binary(max_size=64))
def test_any_frame_is_decoded_or_dropped(identifier, extended, data):
    decoded = FILE.decode(Frame(identifier, data, extended))
    assert decoded is None or all(math.isfinite(value) for value in decoded[1].values())


@given(st.floats(), st.floats(), st.floats())
def test_any_values_are_encoded_reversibly_or_refused(speed, valve, gain):
    try:
        frame = FILE.encode("Command", {"speed": speed, "valve": valve, "gain": gain})
    except DbcError:
        return
    back = carried(frame)
    assert back["speed"] == pytest.approx(speed, abs=0.051)
    assert back["valve"] == pytest.approx(valve, abs=0.51)
    assert back["gain"] == pytest.approx(gain, rel=1e-6, abs=1e-44)


@on_bench("rig")
async def test_short_frame_updates_its_signals_and_the_others_expire(b, pump, /):
    await asyncio.sleep(0.2)
    b.pump.silent = True
    for _ in range(20):
        b.bus.say(512, bytes([10, 0]))
        await asyncio.sleep(0.1)
    assert await pump.execute("read", ["Status.speed"]) == 1.0
    assert await pump.execute("ageOf", ["Status"]) < 0.3
    asyncio.get_running_loop().call_later(0.5, b.bus.say, 512, bytes([10, 0]))
    with pytest.raises(
        DeviceError, match="frame 0x200 has 2 bytes, the file specifies 8: signal heat absent"
    ):
        await pump.execute("read", ["Status.heat"])
    assert b.values["malformed"] >= 20
    b.bus.say(512, bytes([10, 0, 100]))
    assert await pump.execute("read", ["Status.heat"]) == 60.0
    note_text = "message Status invalid: frame 0x200 has 2 bytes, the file specifies 8: signal heat absent"
    assert [note for note in b.notes if "0x200" in note] == [
        note_text,
        "message Status invalid: frame 0x200 has 3 bytes, the file specifies 8",
    ]


@on_bench("rig", opened=False)
async def test_device_with_only_short_frames_is_accepted(b, pump, /):
    b.pump.silent = True
    asyncio.get_running_loop().call_later(0.5, b.bus.say, 512, bytes([0, 0]))
    assert await pump.open() == "DBC device, received Status"


@on_bench("rig", connect=2.0, opened=False)
async def test_absent_device_error_lists_the_received_ids(b, pump, /):
    b.pump.silent = True
    b.bus.say(512, bytes(8), extended=True)
    b.bus.say(0x123, bytes(8))
    with pytest.raises(DeviceError, match=r"other ids were received: 0x200 \(29 bits\), 0x123;"):
        await pump.open()


def test_warnings_of_the_dbc_file_are_noted_at_opening(rig, tmp_path):
    path = tmp_path / "pump.dbc"
    far = ' SG_ far : 60|8@1+ (1,0) [0|0] "" Host\n'
    path.write_text(DBC.read_text().replace("BO_ 2566848768", f"{far}\nBO_ 2566848768"))
    b = rig(dbc=str(path))

    async def mission(pump):
        assert await pump.execute("read", ["Status.heat"]) == 60.0
        with pytest.raises(DeviceError, match=r"Status\.far cannot be used: signal far is beyond its frame"):
            await pump.execute("read", ["Status.far"])

    b.run(mission)
    (note_text,) = [note for note in b.notes if "warning" in note]
    assert re.match(rf"{path}:\d+:6: warning\[DBC901\]: signal far is beyond its frame", note_text)


J1939 = """VERSION ""
BU_: X
BO_ 2566844670 Engine: 8 X
 SG_ turns : 24|16@1+ (0.125,0) [0|8031.875] "rpm" X
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_ "VFrameFormat" BO_ 2566844670 3;
"""


def test_j1939_group_is_read_from_any_one_address(rig, tmp_path):
    path = tmp_path / "engine.dbc"
    path.write_text(J1939)
    waivers = ("device_watchdog", "no_confirmation")
    b = rig(dbc=str(path), commands=[], safe=[], confirm=[], waivers=waivers)
    b.pump.silent = True

    async def mission(engine):
        b.bus.say(0x0CFEF000, bytes([0, 0, 0, 80, 0, 0, 0, 0]), extended=True)
        b.bus.say(0x18FEF001, bytes([0, 0, 0, 90, 0, 0, 0, 0]), extended=True)
        b.bus.say(0x18FEF100, bytes([0, 0, 0, 99, 0, 0, 0, 0]), extended=True)
        assert await engine.execute("read", ["Engine.turns"]) == 10.0
        await asyncio.sleep(2.0)
        b.bus.say(0x18FEF001, bytes([0, 0, 0, 90, 0, 0, 0, 0]), extended=True)
        assert await engine.execute("read", ["Engine.turns"]) == 11.25

    b.run(mission)
    assert sum("comes from two addresses, 0x00 and 0x01" in note for note in b.notes) == 1
