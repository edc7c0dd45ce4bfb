"""How soon a motion that a program gives up has ended, from the cancel at the host, through guard and driver:
to the answer that it was cancelled, and until the device stood, by the log of the fake itself.

A copter is cancelled in full flight of a goTo, a drive and a servo on the way of a moveTo. The copter's
answer comes when it is in its mode for holding: it brakes as gently as its autopilot does. An axis and a
servo answer when they have been seen to stand.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from deaths.device_log import DeviceLog
from guards.copters import bindings, fake_copters
from harness.checkout import Checkout, Mission
from harness.figure import Figure, Opener
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender

from lfield import event_loop
from lfield.driver.kit import cancelled
from lfield.driver.plugin import Plugin
from lfield.testing.driver_bench import bind, guarded
from lfield_can import PLUGIN as CAN
from lfield_dynamixel import PLUGIN as DYNAMIXEL
from lfield_mavlink import PLUGIN as MAVLINK

ANSWERED, STANDING = "to the answer", "until it stood"
#: Cancels in a round.
CANCELS = 5
#: m/s at which a vehicle is cancelled, and of its limit; metres of its way.
FAST, SPEED, FAR = 4.0, 5.0, 80.0
#: Seconds of a time limit, in which it comes to full speed.
LIMIT = 5.0
#: rad/s of an axis and a servo, and rad of their way.
TURNS, WAY = 2.0, 3.0


def _opener(
    plugin: Plugin, kind: str, fake: str, given: Mapping[str, Any], story: Callable[..., Any]
) -> Opener:
    def open(checkout: Checkout, processes: Processes) -> Contender:
        path = processes.folder() / "log"
        endpoint = checkout.fake(processes, *fake.split(), "--log", str(path))
        return lambda: event_loop.run(_round(path, story, plugin, kind, {"endpoint": endpoint, **given}))

    return open


async def _round(path: Path, story: Callable[..., Any], plugin: Plugin, kind: str, given: Any) -> Round:
    found: Round = {ANSWERED: [], STANDING: []}
    log = DeviceLog(path)
    async with guarded(bind(plugin, kind, **given)) as (device,):

        async def cancel(begun: Callable[[], bool], instruction: str, *arguments: object) -> None:
            at = 0.0

            def since() -> bool:
                nonlocal at
                at = time.monotonic()
                return begun()

            await cancelled(device, since, instruction, *arguments)
            found[ANSWERED].append(time.monotonic() - at)
            found[STANDING].append(await _stood(log, at) - at)

        await story(device, cancel)
    return found


async def _stood(log: DeviceLog, since: float) -> float:
    """When the device stood that was cancelled then."""
    while True:
        log.read()
        if log.now["moving"] == "no":
            return max(since, *(change.at for change in log.changes if change.name == "moving"))
        await asyncio.sleep(0.01)


async def _fly(copter: Any, cancel: Callable[..., Any]) -> None:
    """There and back, and never there."""
    await copter.call("waitReady", 60.0)
    await copter.call("arm")
    await copter.call("takeoff", 10.0)
    await copter.call("setSpeed", SPEED)
    for number in range(CANCELS):
        north, east, down = copter.query("position")
        goal = north + (-FAR if number % 2 else FAR), east, down
        await cancel(lambda: copter.query("groundSpeed") >= FAST, "goTo", *goal)
    await copter.call("land")


async def _turn(axis: Any, cancel: Callable[..., Any]) -> None:
    await axis.call("enable")
    for number in range(CANCELS):
        goal = axis.query("position") + (-WAY if number % 2 else WAY)
        await cancel(lambda: abs(axis.query("velocity")) >= 0.9 * TURNS, "moveTo", goal, TURNS)
    await axis.call("disable")


async def _swing(servo: Any, cancel: Callable[..., Any]) -> None:
    await servo.call("setProfile", TURNS, 10.0)
    await servo.call("torque", True)
    for number in range(CANCELS):
        goal = -WAY if number % 2 else WAY
        await cancel(lambda: abs(servo.query("velocity")) >= 0.9 * TURNS, "moveTo", goal)
    await servo.call("torque", False)


def _copter(words: str, **options: Any) -> Opener:
    fake = f"mavlink --listen udp:127.0.0.1:0 --vehicle {words}"
    given = {"ttl": 1.0, "limits": {"speed": SPEED}, "waivers": ["device_watchdog"], **options}
    return _opener(MAVLINK, "Mavlink", fake, given, _fly)


def _axis(device: str, **options: Any) -> Opener:
    given = {"waivers": ["no_homing", "device_watchdog"], "limits": {"speed": 5.0}, "options": options}
    fake = f"can --listen socketcand:127.0.0.1:0 --device {device}"
    return _opener(CAN, "CanAxis", fake, given, _turn)


def _within(checkout: Checkout, processes: Processes) -> Contender:
    """cancels.L: the time limit of a coordinator, through machine and host; from the end of its time."""
    return lambda: _limited(checkout)


def _limited(checkout: Checkout) -> Round:
    with Processes() as own:
        path, found = own.folder() / "log", Round({ANSWERED: [], STANDING: []})
        port = fake_copters(checkout, own, (1,), "--param", "WPNAV_SPEED=500", "--log", str(path))
        log, program = DeviceLog(path), Path(__file__).with_suffix(".L").read_text(encoding="utf-8")
        agents = ["//Copter:copter@here", f"//Impatient:boss@here?{CANCELS}&{LIMIT}&{FAR}"]
        devices = bindings([(port, 1)]).replace("v0:", "copter:")
        (host,) = Mission(own.folder(), program, agents, devices).up(checkout, own)
        while len(found[ANSWERED]) < CANCELS:
            late = float(host.line().removeprefix("over "))
            over = time.monotonic() - late
            found[ANSWERED].append(late)
            found[STANDING].append(event_loop.run(_stood(log, over)) - over)
    return found


_PX4_SPEEDS = ("MPC_XY_VEL_MAX", "MPC_XY_CRUISE", "MPC_VEL_MANUAL")

FIGURE = Figure(
    "A motion that is cancelled on its way",
    {
        "ArduCopter": _copter("1:copter:ardupilot --set-up --param WPNAV_SPEED=500"),
        "ArduCopter, within in L": _within,
        "PX4": _copter(
            f"1:copter:px4 --set-up hold {' '.join(f'--param {name}=5' for name in _PX4_SPEEDS)}",
            safe_state="hold",
        ),
        "CiA 402": _axis("cia402:5", protocol="cia402", node=5, counts=10000),
        "ODrive": _axis("odrive:3", protocol="odrive", node=3),
        "Dynamixel": _opener(DYNAMIXEL, "Dynamixel", "dynamixel --servo 1:XM430-W350", {}, _swing),
    },
    rounds=3,
    one_size="one device, one call",
    notes=(
        f"rounds of {CANCELS} cancels: a copter at {FAST:g} m/s, an axis and a servo at {TURNS:g} rad/s",
        "a copter answers when it is in its mode for holding: then it brakes as gently as it does",
    ),
)
