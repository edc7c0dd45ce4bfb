"""The runner of the kit and its standard checks, with a simulated bench."""

from __future__ import annotations

import asyncio

import pytest

from lfield.driver.binding import DeviceBinding
from lfield.driver.kit import CheckFailed, Kit, run_kit
from lfield.driver.manifest_file import load_manifest
from lfield.driver.standard_checks import KIT as STANDARD
from lfield.errors import DeviceError

MANIFEST = load_manifest(
    "m.yaml",
    b"""\
driver: servo
type: Servo
safe_states: [off]
instructions:
  turn: {parameters: {angle: {type: real}}, blocking: true, cancel: never}
telemetry:
  angle: {type: real, rate: 20.0}
  heat: {type: real}
""",
)


class SimulatedBench:
    """A device that passes all checks, or one that violates the requirement that `breaks` names."""

    identity, silence = "a servo", 0.2

    def __init__(self, breaks: str = "") -> None:
        self.binding = DeviceBinding(
            agent="a", field="s", type="Servo", driver="servo", endpoint="here", safe_state="off"
        )
        self.manifest, self.notes, self.breaks = MANIFEST, [], breaks
        self.latched, self.confirmed = "", False
        self.movements = ["", "turning", "turning more slowly", None]

    @property
    def moving(self):
        if self.breaks == "rest":
            return "turning"
        return self.movements.pop() if len(self.movements) > 1 else self.movements[0]

    async def call(self, instruction, *arguments):
        if instruction == "release":
            self.latched = "" if self.breaks != "release" else self.latched
            return None
        if self.latched and self.breaks != "latch":
            raise DeviceError("s", "held in its safe state; call release() first")
        if any(not abs(value) < 10 for value in arguments) and self.breaks != "nan":
            raise DeviceError("s", "no number")
        return None

    def query(self, quantity):
        if quantity == "heat" or (quantity == "angle" and self.breaks == "telemetry"):
            raise DeviceError("s", f"has not reported {quantity}")
        return "north" if quantity == "angle" and self.breaks == "type" else 0.25

    async def until(self, condition, bound, what):
        for _ in range(4):
            if condition():
                return
        raise CheckFailed(f"waited for {what}")

    async def make_safe(self):
        self.latched, self.confirmed = "asked", True

    async def fall_silent(self, seconds):
        self.latched, self.confirmed = "the host was silent", self.breaks != "silence"

    async def kill_guard(self):
        self.latched, self.confirmed = "its guard died", self.breaks != "death"


def findings(bench, checks=STANDARD.checks, *, may_move=True):
    async def collect():
        return [finding async for finding in run_kit(bench, checks, may_move)]

    return {finding.check: finding for finding in asyncio.run(collect())}


def test_correct_device_passes_every_check():
    found = findings(SimulatedBench())
    assert {finding.outcome for finding in found.values()} == {"passed"}
    assert found["identity"].seen == "a servo at here"
    assert found["telemetry"].seen == "1 quantities (not heat), last message 250 ms ago"


@pytest.mark.parametrize(
    ("breaks", "check", "words"),
    [
        ("telemetry", "telemetry", "it does not report angle"),
        ("type", "telemetry", "'north' is not a real"),
        ("nan", "non-finite numbers are refused", "turn(nan) was executed"),
        ("latch", "the safe state is latched until release", "turn(0.0) was executed"),
        ("release", "the safe state is latched until release", "waited for the latch to be released"),
        ("rest", "it comes to rest in its safe state", "it was not at rest within 120 s: turning"),
        ("death", "the safe state follows the death of a guard", "waited for 'off' to be confirmed"),
        ("silence", "a host that stops responding", "waited for 'off' to be confirmed"),
    ],
)
def test_each_violated_requirement_fails_its_check(breaks, check, words):
    found = findings(SimulatedBench(breaks))
    assert found[check].outcome == "failed"
    assert words in found[check].seen


def test_checks_that_move_do_not_run_without_permission():
    found = findings(SimulatedBench(), may_move=False)
    assert {f.check for f in found.values() if f.outcome == "passed"} == {
        "identity", "telemetry", "its own watchdog",
    }  # fmt: skip
    assert {f.outcome for f in found.values()} == {"passed", "not run"}


def test_driver_checks_run_for_their_types_and_a_raising_check_fails():
    kit = Kit()

    @kit.check("mine", moves=False, types=("Servo",))
    async def mine(bench):
        return "seen"

    @kit.check("of another type", moves=False, types=("Arm",))
    async def another(bench):
        raise AssertionError

    @kit.check("broken", moves=False)
    async def broken(bench):
        return str(1 // 0)

    found = findings(SimulatedBench(), kit.checks)
    assert list(found) == ["mine", "broken"]
    assert found["mine"].seen == "seen"
    assert "the check itself is broken: ZeroDivisionError" in found["broken"].seen


def test_failed_check_leaves_the_device_released():
    kit, bench = Kit(), SimulatedBench()

    @kit.check("fails while it is latched", moves=True)
    async def fails(bench):
        await bench.make_safe()
        raise CheckFailed("something else")

    @kit.check("turns", moves=True)
    async def turns(bench):
        await bench.call("turn", 0.1)
        return "turned"

    found = findings(bench, kit.checks)
    assert [f.outcome for f in found.values()] == ["failed", "passed"]


def test_safe_state_checks_do_not_run_for_a_sensor():
    eye = b"driver: eye\ntype: Eye\ntelemetry: {angle: {type: real, rate: 20.0}}\n"
    bench = SimulatedBench()
    bench.manifest = load_manifest("m.yaml", eye)
    bench.binding = DeviceBinding(agent="a", field="s", type="Eye", driver="eye", endpoint="here")
    bench.kill_guard = bench.fall_silent = lambda *given: asyncio.sleep(0)
    found = findings(bench, may_move=False)
    assert {check for check, finding in found.items() if finding.outcome == "not run"} == {
        "the safe state is latched until release", "it comes to rest in its safe state",
    }  # fmt: skip
    assert {finding.outcome for finding in found.values()} == {"passed", "not run"}
