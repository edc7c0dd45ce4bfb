"""A steering column that supervises its commands: counter, checksum and deadline. On virtual time."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
import pytest
from can_scenarios import BOUND
from coroutine_tests import scenario
from crccheck.crc import Crc8GsmA

import lfield_sim.can
from lfield.driver import DeviceError
from lfield.errors import UsageError
from lfield.simulate.jumping_loop import LoopClock, run_jumping
from lfield.testing.desk import Desk
from lfield_can.bus.frames import Frame
from lfield_sim.can.can_bus import FAULTS
from lfield_sim.can.device_specs import build, parse, spec_of
from lfield_sim.faults import Faults

STEERING = Path(lfield_sim.can.__file__).with_name("steering.dbc")
STATUS = 0x121
OPTIONS = {
    "dbc": str(STEERING),
    "commands": ["SteeringCommand"],
    "safe": ["SteeringCommand.Enable=0", "SteeringCommand.TargetAngle=0"],
    "confirm": ["SteeringStatus.Enable=0"],
    "cyclic": ["SteeringCommand"],
    "counters": ["SteeringCommand.Counter=15", "SteeringStatus.Counter=15"],
    "checksums": ["SteeringCommand.Check=e2e_1 0x2A7", "SteeringStatus.Check=e2e_1 0x2A7"],
    "accepted": ["SteeringStatus.Fault=0"],
    "max_age": 0.5,
}


@pytest.fixture
def steering(binding):
    def make(*, waivers=("device_watchdog",), **options):
        settings = {**OPTIONS, **options}
        return binding("CanSignals", field="steering", options=settings, waivers=list(waivers), ttl=1.0)

    return make


@pytest.fixture
def play(steering, monkeypatch):
    """Run a scenario with the column behind a guard; `fitted` has the options of another binding, from which
    the simulated device is made."""

    def run(steps, *, fitted=None, **options):
        desk = Desk()
        fake = desk.fake("can", "--device", spec_of(steering(**(fitted or {}))))
        changed = msgspec.structs.replace(steering(**options), endpoint=fake.endpoint)
        desk.run(lambda column: steps(fake, column), changed)

    return run


async def angle(column):
    return await column.call("read", "SteeringStatus.Angle")


async def drives(column, goal=0.3, seconds=1.5):
    """Set the angle ten times a second."""
    for _ in range(round(seconds / 0.1)):
        await column.call("send", "SteeringCommand", [1.0, goal])
        await asyncio.sleep(0.1)


@scenario("play")
async def test_column_follows_and_an_expired_setpoint_ends(fake, column, /):
    await drives(column)
    assert await angle(column) == pytest.approx(0.3, abs=0.02)
    assert await column.call("read", "SteeringStatus.Fault") == 0.0
    await column.until(lambda: column.confirmed, BOUND, "the guard to end it")
    await column.until_note("the setpoint has expired")
    assert await column.call("read", "SteeringStatus.Enable") == 0.0
    # The safe state is repeated within its deadline.
    await asyncio.sleep(0.5)
    assert await column.call("read", "SteeringStatus.Fault") == 0.0
    assert column.query("overruns") == 0


@scenario("play")
async def test_device_acts_when_the_frames_of_a_silent_host_end(fake, column, /):
    await drives(column, seconds=0.3)
    await column.fall_silent(1.0)
    assert await column.call("read", "SteeringStatus.Fault") == 1.0
    assert await column.call("read", "SteeringStatus.Enable") == 0.0


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (
            {
                "counters": ["SteeringStatus.Counter=15"],
                "safe": [*OPTIONS["safe"], "SteeringCommand.Counter=0"],
            },
            "Fault is 1",
        ),
        ({"checksums": ["SteeringCommand.Check=e2e_1 0x2A8", OPTIONS["checksums"][1]]}, "Fault is 1"),
        ({"cyclic": ["SteeringCommand=0.2"]}, "Fault is 1"),
    ],
)
def test_device_that_rejects_its_commands_is_held_safe(play, wrong, reason):
    async def steps(fake, column):
        values = [1.0, 0.3] if "safe" not in wrong else [0.0, 1.0, 0.3]
        while not column.latched:
            await column.call("send", "SteeringCommand", values)
            await asyncio.sleep(0.3)
        assert column.latched == f"its commands are not accepted: SteeringStatus.{reason}.0"
        assert await angle(column) == pytest.approx(0.0, abs=0.02)

    play(steps, fitted={}, **wrong)


def test_status_with_a_wrong_counter_or_checksum_is_dropped(bench, steering, bus):
    def status(counter, number=0x2A7):
        rest = bytes([counter, 0, 0, 0, 0, 0, 0])
        return Frame(STATUS, bytes([Crc8GsmA.calc(number.to_bytes(2, "little") + rest)]) + rest)

    async def steps(column):
        short = Frame(STATUS, b"\xff" * 6)
        frames = status(0), status(1), status(1), status(2, 0x2A8), status(15), short, status(4)
        for frame in frames:
            bus.received(frame)
        await asyncio.sleep(0.2)
        assert b.values["malformed"] == 4
        assert await column.execute("read", ["SteeringStatus.Angle"]) == 0.0
        reasons = (
            *("counter Counter is not incremented", "checksum Check is", "counter Counter is 15, beyond 14"),
            "6 of 8 bytes: its counter and checksum cannot be checked",
        )
        for reason in reasons:
            assert any(f"message SteeringStatus invalid: {reason}" in note for note in b.notes)
        await asyncio.sleep(0.4)
        bus.received(status(5, 0x2A8))
        await asyncio.sleep(0.2)
        with pytest.raises(DeviceError, match=r"Angle was not received for over 0.5 s: checksum Check is 0x"):
            await column.execute("read", ["SteeringStatus.Angle"])

    async def first(number=0x2A7):
        await asyncio.sleep(0.1)
        bus.received(status(14, number))

    b = bench(steering(), bus=bus, fakes=[first])
    b.run(steps)
    with pytest.raises(
        DeviceError, match=r"its messages are not used \(SteeringStatus: checksum Check is 0x"
    ):
        bench(steering(), bus=bus, fakes=[lambda: first(0x2A8)]).run(steps)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cyclic": ["SteeringStatus"]}, "SteeringStatus cannot be cyclic: it is not among its 'commands'"),
        ({"cyclic": ["SteeringCommand=0.0001"]}, "the period of SteeringCommand is 0.001 to 10 s"),
        ({"cyclic": ["SteeringCommand=fast"]}, "does not have the form Message or Message=SECONDS"),
        ({"cyclic": ["SteeringCommand=1e"]}, "'1e' is not a number"),
        (
            {"safe": [*OPTIONS["safe"], "SteeringCommand.Counter=1"]},
            "it is the counter, which this driver sets",
        ),
        ({"accepted": ["SteeringCommand.Enable=1"]}, "'accepted' requires a message from the device"),
        ({"checksums": ["SteeringCommand.Check=e2e_1"]}, "requires 1 data ids, not 0"),
    ],
)
def test_invalid_supervision_option_is_refused(bench, steering, options, words):
    async def steps(column):
        raise AssertionError("the device must not be opened")

    with pytest.raises(DeviceError, match=words):
        bench(steering(**options)).run(steps)


def test_cyclic_message_without_a_period_is_refused(bench, steering, tmp_path):
    path = tmp_path / "steering.dbc"
    path.write_text(STEERING.read_text().replace('"GenMsgCycleTime" BO_ 288', '"Other" BO_ 288'))
    with pytest.raises(DeviceError, match="no GenMsgCycleTime for SteeringCommand; write its period"):
        bench(steering(dbc=str(path))).run(lambda column: None)


def test_late_cyclic_frames_are_skipped_and_counted(bench, steering, bus):
    """A loop that is blocked for five periods sends one frame late, not five at once."""
    b = bench(steering(confirm=[], accepted=[], waivers=["device_watchdog", "no_confirmation"]), bus=bus)

    clock = LateClock()

    async def steps(column):
        await column.execute("send", ["SteeringCommand", [1.0, 0.1]])
        await asyncio.sleep(0.09)
        before = len(bus.sent)
        clock.late += 0.1
        await asyncio.sleep(0.025)
        assert len(bus.sent) == before + 1
        await asyncio.sleep(0.2)
        assert b.values["overruns"] == 5
        assert [note for note in b.notes if note.code == "can-cycle-overrun"] != []
        counters = [frame.data[1] & 0xF for frame in bus.sent]
        assert counters == [count % 15 for count in range(len(counters))]

    run_jumping(b.play(steps, clock))


class LateClock(LoopClock):
    """The loop's time plus the time of a simulated delay."""

    late = 0.0

    def monotonic(self):
        return super().monotonic() + self.late


@pytest.mark.parametrize("text", [",checksums=SteeringCommand.Check:md5", ",counters=Nothing.Counter"])
def test_invalid_property_of_a_simulated_device_is_refused(text):
    with pytest.raises(UsageError, match=r"is not a checksum|is not in the file"):
        build([parse(f"dbc:{STEERING}{text}")], Faults(FAULTS, {}))
