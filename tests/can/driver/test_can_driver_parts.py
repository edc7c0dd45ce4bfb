"""The small parts of the CAN driver: endpoints, error texts, units, periodic tasks, stock resources."""

from __future__ import annotations

import asyncio
import math
import struct
from pathlib import Path

import pytest
from can_local_drive import dictionary
from hypothesis import given
from hypothesis import strategies as st

from lfield.errors import DeviceError
from lfield.lang.frontend import check_text
from lfield.simulate.jumping_loop import LoopClock, run_jumping
from lfield_can import PLUGIN
from lfield_can.bus.endpoint import parse_endpoint
from lfield_can.bus.error_frames import ACTIVE, OFF, PASSIVE, WARNING, linux_error, pcan_error
from lfield_can.bus.frames import EXTENDED, Frame
from lfield_can.protocols import PROTOCOLS
from lfield_can.protocols.canopen_node import read_eds, standard_dictionary
from lfield_can.protocols.cia402_tables import (
    OBJECTS,
    STATES,
    TPDO,
    TRANSMITTED,
    Units,
    error_text,
    state_of,
)
from lfield_can.protocols.odrive_tables import error_text as odrive_error_words
from lfield_can.protocols.pdo_setup import PdoConfiguration
from lfield_can.protocols.process_data import Pdo, ProcessData
from lfield_can.timing import PeriodicTask

MANIFESTS = PLUGIN.read_manifests()


@pytest.mark.parametrize(
    ("endpoint", "arguments"),
    [
        ("socketcan:can0", {"interface": "socketcan", "channel": "can0", "fd": True}),
        ("socketcan:can0?fd=true", {"interface": "socketcan", "channel": "can0", "fd": True}),
        ("virtual:a", {"interface": "virtual", "channel": "a"}),
        (
            "slcan:/dev/ttyACM0@115200?bitrate=500000",
            {"interface": "slcan", "channel": "/dev/ttyACM0", "tty_baudrate": 115200, "bitrate": 500000}
            | {"sleep_after_open": 0.0},
        ),
        (
            "socketcand:[::1]:29536/can0",
            {"interface": "socketcand", "channel": "can0"},
        ),
        ("pcan:PCAN_1?bitrate=500000", {"interface": "pcan", "channel": "PCAN_1", "bitrate": 500000}),
    ],
)  # fmt: skip
def test_endpoint_is_parsed(endpoint, arguments):
    assert parse_endpoint(endpoint).arguments == arguments


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [
        ("can0", "write INTERFACE:CHANNEL"),
        ("", "write INTERFACE:CHANNEL"),
        ("socketcan:", "write INTERFACE:CHANNEL"),
        ("socketcan:can0?fd", "write INTERFACE:CHANNEL"),
        ("socketcant:can0", "python-can has no interface 'socketcant'"),
        ("slcan:ttyACM0", "write slcan:/dev/ttyACM0@115200"),
        ("slcan:/dev/ttyACM0@fast", "write slcan:/dev/ttyACM0@115200"),
        ("socketcand:127.0.0.1/can0", "write socketcand:HOST:PORT/CHANNEL"),
        ("socketcand:127.0.0.1:99999/can0", "write socketcand:HOST:PORT/CHANNEL"),
        ("socketcand:127.0.0.1:29536/can0?bitrate=1", "socketcand takes no parameters"),
    ],
)
def test_invalid_endpoint_is_refused_with_its_form(endpoint, words):
    with pytest.raises(DeviceError, match=words):
        parse_endpoint(endpoint)


@given(st.text())
def test_any_text_is_an_endpoint_or_a_device_error(text):
    try:
        parse_endpoint(text)
    except DeviceError:
        return


def test_standard_and_extended_ids_have_different_keys():
    assert Frame(0x123).key == 0x123
    assert Frame(0x123, extended=True).key == 0x123 | EXTENDED


@pytest.mark.parametrize(
    ("read", "identifier", "data", "words", "state"),
    [
        (linux_error, 0x040, "00", "bus off", OFF),
        (
            linux_error,
            0x004,
            "0022",
            "controller problem (send buffer full, error passive by send errors)",
            PASSIVE,
        ),
        (linux_error, 0x004, "0008", "controller problem (many send errors)", WARNING),
        (linux_error, 0x004, "0040", "controller problem (error active again)", ACTIVE),
        (linux_error, 0x028, "", "protocol violation, no acknowledgement of a frame", ""),
        (
            linux_error,
            0x288,
            "0000841900008f03",
            "protocol violation (bit stuffing, while sending, in the acknowledgement), bus error; errors "
            "counted: 143 sending, 3 receiving",
            "",
        ),
        (linux_error, 0x010, "0000000070", "transceiver problem (CAN-L shorted to ground)", ""),
        (linux_error, 0x100, "", "controller restarted", ACTIVE),
        (linux_error, 0, "", "an error of unknown class", ""),
        (
            pcan_error,
            0x02,
            "001a0380",
            "protocol violation (form while sending, in the end of frame); errors counted: 128 sending, 3 "
            "receiving",
            PASSIVE,
        ),
        (
            pcan_error,
            0x10,
            "",
            "protocol violation (an unknown type while sending); errors counted: 0 sending, 0 receiving",
            ACTIVE,
        ),
    ],
)
def test_error_frame_is_described(read, identifier, data, words, state):
    report = read(identifier, bytes.fromhex(data))
    assert (report.text, report.state) == (words, state)


@pytest.mark.parametrize(
    ("code", "register", "words"),
    [
        (0x7121, 0, "motor blocked (0x7121)"),
        (0x8130, 0x10, "our heartbeat was missed (0x8130)"),
        (0x3219, 0, "supply over-voltage (0x3219)"),
        (0x4F00, 0, "temperature (0x4F00)"),
        (0xA000, 0, "unknown error (0xA000)"),
        (0, 0x0A, "current, temperature"),
        (0, 0, ""),
    ],
)
def test_drive_error_is_described(code, register, words):
    assert error_text(code, register) == words


def test_odrive_error_is_described():
    assert odrive_error_words(0) == ""
    assert odrive_error_words(1 << 25 | 1 << 8) == "supply over-voltage, emergency stop"
    assert odrive_error_words(1 << 31) == "unknown error 0x80000000"


@given(st.integers(0, 0xFFFF))
def test_status_word_shows_one_state_at_most(statusword):
    fitting = [name for mask, value, name in STATES if statusword & mask == value]
    assert len(fitting) <= 1
    assert state_of(statusword) == "".join(fitting)


@given(st.floats(-100.0, 100.0), st.floats(0.1, 100.0), st.booleans())
def test_unit_conversion_is_reversible(value, gear, is_reversed):
    turns = (-gear if is_reversed else gear) / math.tau
    for unit in ("counts", "rpm", "milli_rpm"):
        units = Units(turns, 100_000, unit, 0.5, 2.0)
        assert units.position(units.to_counts(value)) == pytest.approx(value, abs=1e-3)
        assert units.velocity(units.to_velocity(value)) == pytest.approx(value, abs=2.0)
        assert units.torque(units.to_torque(value)) == pytest.approx(value, abs=gear / 1000.0)
        if not is_reversed:
            assert units.to_velocity(value) * value >= 0.0


def test_unit_conversion_of_a_drive_in_rpm():
    units = Units(10.0 / math.tau, 4096, "rpm", 0.5)
    assert units.to_velocity(math.tau) == 600  # one turn of the axis per second, behind 10:1
    assert units.to_counts(math.tau) == 40960
    assert units.to_torque(5.0) == 1000


def test_periodic_task_ends_after_its_time_and_when_stopped():
    async def scenario():
        loop, done = asyncio.get_running_loop(), []
        repeating = PeriodicTask(LoopClock())
        start = loop.time()
        repeating.start(0.1, lambda: done.append(round(loop.time() - start, 3)), duration=0.35)
        await asyncio.sleep(1.0)
        assert done == [0.1, 0.2, 0.3]
        repeating.resume()
        await asyncio.sleep(0.25)
        repeating.stop()
        await asyncio.sleep(1.0)
        assert len(done) == 5

    run_jumping(scenario())


def test_every_protocol_of_the_manifest_is_implemented():
    option = next(option for option in MANIFESTS["CanAxis"].options if option.name == "protocol")
    assert set(option.choices) == set(PROTOCOLS)


def test_standard_objects_equal_the_table():
    dictionary = standard_dictionary()
    for (index, subindex), (name, data_type) in OBJECTS.items():
        variable = dictionary.get_variable(index, subindex)
        assert (variable.name, variable.data_type) == (name, data_type)


# canopen's writer, which is used only here, calls utcnow(), deprecated since Python 3.12.
@pytest.mark.filterwarnings("ignore:datetime.datetime.utcnow:DeprecationWarning:canopen")
def test_valid_eds_file_is_read_and_invalid_one_is_refused(tmp_path):
    import canopen

    good, bad = tmp_path / "drive.eds", tmp_path / "bad.eds"
    od = dictionary(set())
    od.node_id = 5
    with good.open("w") as file:
        canopen.export_od(od, file, "eds")
    assert read_eds("axis", str(good), 5).get_variable(0x6041, 0).name == "6041-0"
    bad.write_text("[nothing\n")
    with pytest.raises(DeviceError, match="is not a readable EDS file"):
        read_eds("axis", str(bad), 5)


MISSION = """
include <can/{file}.L>;
coordinator Mission {{
    init(string[] arg) {{
        {body}
    }}
}}
"""
BODIES = {
    "axis": (
        'Axis a = findAxis("a"); a.home(); a.moveTo(1.0, 0.5); '
        "a.turnTo(a.velocity() + a.torque()); a.stop(); print(a.fault());"
    ),
    "winch": 'Winch w = findWinch("w"); w.home(); w.lower(w.lift(0.5)); w.reach(w.length()); w.hold();',
}


@pytest.mark.parametrize("file", sorted(BODIES))
def test_can_stock_resource_compiles_and_offers_its_portals(file):
    def find(path: str) -> Path | None:
        plugin, _, name = path.partition("/")
        return PLUGIN.source(name) if plugin == "can" else None

    devices = {name: manifest.device for name, manifest in MANIFESTS.items()}
    text = MISSION.format(file=file, body=BODIES[file])
    checked = check_text(text, devices=devices, find_include=find)
    assert [diagnostic.render() for diagnostic in checked.diagnostics] == []


frames = st.lists(
    st.tuples(st.sampled_from([0x80, 0x180, 0x280, 0x380, 0x580, 0x700]), st.binary(max_size=8)), max_size=30
)


@given(frames)
def test_cia402_axis_survives_any_frames(bench, binding, frames):
    b = bench(binding("CanAxis", options={"protocol": "cia402", "node": 5, "counts": 1000}))

    async def mission(axis):
        tpdos = [
            Pdo(n + 1, first + 5, entries)
            for n, (first, entries) in enumerate(zip(TRANSMITTED, TPDO.mappings, strict=False))
        ]
        axis.protocol.pdo_configuration = PdoConfiguration(ProcessData(tpdos))
        for code, data in frames:
            b.bus.say(code + 5, data)
        assert axis.malformed <= len(frames)
        short = struct.Struct("<H").size
        assert axis.malformed >= sum(code == 0x180 and len(data) < short for code, data in frames)

    b.run(mission, opened=False)
