"""DroneCAN nodes behind their guard on virtual time: fixed and dynamic ids, faults, two nodes with one id."""

from __future__ import annotations

import asyncio

import msgspec
import pytest

from lfield.driver import DeviceError
from lfield.errors import DevicesError
from lfield.testing.desk import Desk
from lfield_sim.can.device_specs import merged, parse, spec_of

UNIQUE_ID = "00112233445566778899aabbccddeeff"


@pytest.fixture
def node(binding):
    def make(kind, *, waivers=("device_watchdog",), safe_state="hold", **options):
        settings = {"safe_state": safe_state, "waivers": list(waivers)} if kind == "DroneCanServo" else {}
        field = f"{kind[8:].lower()}{options['node']}_{options.get('index', 0)}"
        return binding(kind, field=field, options=options, **settings)

    return make


def play(scenario, *bindings):
    desk = Desk()
    specs = {}
    for each in bindings:
        text = spec_of(each)
        specs[parse(text).id] = merged(specs.get(parse(text).id, text), text)
    fake = desk.fake("can", *(argument for text in specs.values() for argument in ("--device", text)))
    made = [msgspec.structs.replace(each, endpoint=fake.endpoint) for each in bindings]
    desk.run(lambda *devices: scenario(fake, *devices), *made)


def test_three_nodes_are_read_and_a_servo_moves(node):
    async def scenario(fake, battery, esc, servo, second):
        assert battery.query("voltage") == pytest.approx(16.8, abs=0.1)
        assert battery.query("state") == "in use"
        assert battery.query("charge") == pytest.approx(1.0, abs=0.01)
        assert esc.query("speed") == 0.0
        assert esc.query("temperature") == pytest.approx(25.0, abs=0.3)
        assert "lfield.fake.servo" in servo.identity
        await servo.call("moveTo", 0.5)
        assert servo.query("position") == pytest.approx(0.5, abs=0.02)
        assert second.query("position") == pytest.approx(0.0, abs=0.01)
        with pytest.raises(DeviceError, match=r"moveTo\(2\) is outside -1.57 to 1.57 rad"):
            await servo.call("moveTo", 2.0)
        fake.fault("overheat@40=true")
        assert await battery.reads("fault", bool) == "too hot"
        await battery.reads("health", lambda text: text == "error")

    nodes = node("DroneCanBattery", node=40), node("DroneCanEsc", node=41)
    play(scenario, *nodes, node("DroneCanServo", node=42), node("DroneCanServo", node=42, index=1))


def test_expired_setpoint_stops_the_servo_where_it_is(node):
    async def scenario(fake, servo):
        for _ in range(3):
            await servo.call("setPosition", 1.5)
            await asyncio.sleep(0.1)
        await servo.until(lambda: servo.confirmed, 10.0, "its safe state")
        at = servo.query("position")
        assert 0.5 < at < 1.55
        await asyncio.sleep(2.0)
        assert servo.query("position") == pytest.approx(at, abs=0.02)

    play(scenario, node("DroneCanServo", node=42))


def test_nodes_get_the_node_id_of_their_unique_id(node):
    """Two nodes without ids ask at the same time; each receives the id of the binding with its unique id."""

    async def scenario(fake, servo, battery):
        await servo.call("moveTo", -0.4)
        assert servo.query("position") == pytest.approx(-0.4, abs=0.02)
        assert battery.query("charge") > 0.9
        notes = [note for note in servo.notes if "node id" in note]
        assert any(f"node id 42 assigned to the unique id {UNIQUE_ID}" in note for note in notes)
        fake.fault("silence@42=true")
        await servo.until_note("link lost")
        fake.fault("silence@42=false")
        await servo.until_note("link restored")
        await servo.reads("online", lambda value: value is True)

    servo = node("DroneCanServo", node=42, unique_id=UNIQUE_ID)
    battery = node("DroneCanBattery", node=43, unique_id=UNIQUE_ID[::-1])
    play(scenario, servo, battery)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("stuck@42=true", "moveTo failed: no progress for 2 s"),
        ("lost_tpdo@42=true", r"no message for 0\.\d s"),
    ],
)
def test_servo_fault_fails_its_motion(node, fault, words):
    async def scenario(fake, servo):
        fake.fault(fault)
        with pytest.raises(DeviceError, match=words):
            await servo.call("moveTo", 1.0)
        fake.fault(fault.replace("true", "false"))
        await asyncio.sleep(0.3)
        at = servo.query("position")
        await asyncio.sleep(2.0)
        assert servo.query("position") == pytest.approx(at, abs=0.02), "it does not go on"

    play(scenario, node("DroneCanServo", node=42))


@pytest.mark.parametrize(
    ("bindings", "words"),
    [
        ([{"unique_id": "12"}], "'unique_id' has 32 hexadecimal digits, not '12'"),
        ([{"unique_id": "x" * 32}], "'unique_id' has 32 hexadecimal digits"),
        ([{"master": 42}], r"node 42 is this computer \('master'\)"),
        ([{}, {"node": 43, "index": 1, "master": 99}], "two node ids"),
        ([{}, {"index": 1, "unique_id": UNIQUE_ID}], "one node id or one unique id"),
        ([{"unique_id": UNIQUE_ID}, {"node": 43, "index": 1, "unique_id": UNIQUE_ID}], "one unique id"),
        ([{}, {"node": 43, "index": 1}, {"node": 44, "index": 1}], r"the same actuator 'index' \(1\)"),
    ],
)
def test_conflicting_dronecan_bindings_are_refused(bench, node, bindings, words):
    made = [node("DroneCanServo", **{"node": 42, **each}) for each in bindings]
    with pytest.raises(DeviceError, match=words):
        bench(*made).run(lambda *_: None)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"node": 50}, "no message of node 50 at"),
        ({"node": 42, "index": 7}, "node 42 sends no DroneCanServo messages with index 7"),
        ({"node": 50, "unique_id": UNIQUE_ID}, "no node with this unique id asked"),
    ],
)
def test_absent_dronecan_node_is_an_error(node, options, words):
    async def scenario(servo):
        raise AssertionError("the device must not be opened")

    desk = Desk()
    fake = desk.fake("can", "--device", "dronecan:42")
    changed = msgspec.structs.replace(node("DroneCanServo", connect=2.0, **options), endpoint=fake.endpoint)
    with pytest.raises(DevicesError, match=words):
        desk.run(scenario, changed)
