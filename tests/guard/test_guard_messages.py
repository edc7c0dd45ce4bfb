"""Messages between host and guard: encoding, decoding, types of values, and the log without a host."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.clock import ManualClock
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import STANDARD_INSTRUCTIONS, Manifest, Option
from lfield.driver.driver_index import DriverInfo, ManifestFile
from lfield.driver.value_types import conform
from lfield.errors import WireError
from lfield.guard.messages import (
    JSON_LOG_HOST,
    MESSAGES,
    CallDone,
    GuardCall,
    Latched,
    MessageReader,
    Note,
    OpenDevices,
    OrphanLog,
    Stopped,
    TelemetrySnapshot,
    encode,
)
from lfield.manifest import DeviceManifest, Observation, Quantity
from lfield.text import log_messages
from lfield.text.log_messages import report_fields

BINDING = DeviceBinding(
    agent="a",
    field="f",
    type="T",
    driver="d",
    endpoint="e",
    safe_state="off",
    limits={"speed": 1.5},
    options={"id": 3},
)
MANIFEST = Manifest(
    DeviceManifest("T", "d", STANDARD_INSTRUCTIONS, (Quantity("angle", "real", "rad"),), ("off",)),
    (Option("id", "int", 1), Option("gear", "real", 1.0)),
)
DRIVER = DriverInfo("d", "lfield_d:PLUGIN", {"T": MANIFEST}, {"T": ManifestFile("t.yaml", bytes(32))}, "d 1")
SAMPLES = [
    OpenDevices([BINDING], "again", 0.2, DRIVER, ["a.f"]),
    GuardCall(7, "a.f", "go", [1.5, True, "text", [1, 2], [0.5], None, -3], 12.25, 12.75),
    CallDone(7, [1.0, 2.0]),
    TelemetrySnapshot(
        "a.f", {"mode": Observation("GUIDED", 7.9), "armed": Observation(True, 7.8)}, 7.95, True
    ),
]


@pytest.mark.parametrize("size", [1, 3, 1000])
def test_messages_are_decoded_from_pieces_of_any_size(size):
    data = b"".join(map(encode, SAMPLES))
    reader = MessageReader()
    decoded = [m for i in range(0, len(data), size) for m in reader.feed(data[i : i + size])]
    assert decoded == SAMPLES


@given(st.integers(0, 30), st.binary(max_size=60))
def test_random_bytes_are_decoded_or_raise_a_wire_error(kind, payload):
    data = (len(payload) + 1).to_bytes(4, "big") + bytes([kind]) + payload
    try:
        messages = list(MessageReader().feed(data))
    except WireError:
        return
    assert all(isinstance(m, MESSAGES) for m in messages)


@pytest.mark.parametrize(
    ("value", "kind", "result"),
    [
        (3, "real", 3.0),
        (3, "int", 3),
        (True, "boolean", True),
        ([1, 2.5], "real[]", [1.0, 2.5]),
        ("x", "string", "x"),
    ],
)
def test_value_is_converted_to_its_type(value, kind, result):
    converted = conform(value, kind)
    assert converted == result
    assert type(converted) is type(result)


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (True, "int"),
        (1, "boolean"),
        (1.5, "int"),
        ("1", "real"),
        (None, "real"),
        (1 << 63, "int"),
        ("ab", "int[]"),
    ],
)
def test_value_of_another_type_is_refused(value, kind):
    with pytest.raises(ValueError, match="is not a"):
        conform(value, kind)


def test_nan_member_of_a_list_survives_the_pipe():
    values = {"positions": Observation([0.5, math.nan], 1.0), "missing": Observation([2], 1.0)}
    (decoded_message,) = MessageReader().feed(encode(TelemetrySnapshot("arm.joints", values, 1.0)))
    assert decoded_message.values["missing"].value == [2]
    assert decoded_message.values["positions"].value[0] == 0.5
    assert math.isnan(decoded_message.values["positions"].value[1])


@pytest.fixture
def orphan_log() -> OrphanLog:
    log = OrphanLog(ManualClock())
    log.on_opening([BINDING])
    return log


DEVICE = BINDING.name
REPORT = Note(DEVICE, *report_fields(log_messages.SERIAL_LOST.line(reason="unplugged")))


def test_report_without_a_host_has_the_text_of_a_host_log(orphan_log, capsys, monkeypatch):
    monkeypatch.delenv(JSON_LOG_HOST, raising=False)
    orphan_log.write(REPORT)
    orphan_log.write(Note(DEVICE, "warming up"))
    orphan_log.write(Latched(DEVICE, "fog", False))
    orphan_log.write(Latched(DEVICE, "fog", True))
    assert capsys.readouterr().err.splitlines() == [
        f"{DEVICE} link lost: unplugged; reopening the serial port",
        f"{DEVICE}: warming up",
        f"{DEVICE} in safe state '{BINDING.safe_state}': fog",
    ]


def test_report_without_a_host_keeps_its_code_in_json(orphan_log, capsys, monkeypatch):
    monkeypatch.setenv(JSON_LOG_HOST, "alpha")
    for message in (REPORT, Latched(DEVICE, "fog", True, "hold"), Stopped({DEVICE: "moves"})):
        orphan_log.write(message)
    found = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert {line["host"] for line in found} == {"alpha"}
    assert {line["fields"]["device"] for line in found} == {DEVICE}
    assert [(line["code"], line["level"]) for line in found] == [
        ("serial-lost", "warning"),
        ("device-safe", "warning"),
        ("device-not-safe", "error"),
    ]
    assert found[1]["fields"]["state"] == "hold"
