"""Flying copters under real hosts: separate fakes that outlive every host, each with an observer."""

from __future__ import annotations

import os
import signal
import time

from mavlink_observer import BOUND, MavlinkObserver

#: A copter that hovers, and a coordinator that waits.
PROGRAM = """
resource Copter {
    Mavlink fc;
    init(string[] arg) { fc.arm(); fc.takeoff(3.0); write("flies\\n"); }
    portal stay(real seconds) { sleep(seconds); }
}
coordinator Pilot { init(string[] arg) { findCopter(arg[1]).stay(s2f(arg[2])); } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Pilot:pilot@alpha?lead&{stay}\n"
DEVICE = """
  {agent}:
    devices:
      fc:
        {{driver: mavlink, endpoint: '{endpoint}', system: 1,
         waivers: [device_watchdog], rest_within: {within}}}
"""
CLIMB = ("--climb", "6", "--acceleration", "10")
#: Three metres at this speed take some seconds.
SLOW = ("--land", "0.5", "--descend", "0.5")
SLOWEST = ("--land", "0.25", "--descend", "0.25")
#: A copter that touches down faster than 2 m/s has crashed.
BRISK = ("--land", "1.9", "--descend", "2.4")


def devices(endpoints: dict[str, str], within: float, heap: str = "1 MiB") -> str:
    """The devices file for copters at these endpoints, by agent."""
    bound = [DEVICE.format(agent=a, endpoint=e, within=within) for a, e in endpoints.items()]
    return f"silence: 2.0\ndefaults: {{heap: {heap}}}\nagents:" + "".join(bound)


def copter(lfield, environment, land=BRISK) -> str:
    """The endpoint of a fake that runs until the test ends."""
    arguments = (
        "sim",
        "mavlink",
        "--listen",
        "udp:127.0.0.1:0",
        "--set-up",
        "--until-stdin-closes",
        *CLIMB,
        *land,
    )
    return lfield.start(*arguments, stdin=True, env=environment).wait_for(r"^ready (\S+)")[1]


def landed(witness: MavlinkObserver, bound: float = BOUND) -> None:
    """Wait until a vehicle reports that it has landed with its motors off."""
    witness.until(lambda seen: not seen.armed and seen.height < 0.3, bound)


def signal_at_once(process, *numbers: signal.Signals) -> None:
    """Send different signals that the process receives at the same time under any load."""
    for number in (signal.SIGSTOP, *numbers, signal.SIGCONT):
        process.signal(number)


class Flight:
    """A flying copter under one host. `options` are for `lfield up`, `started` for its process."""

    def __init__(
        self,
        lfield,
        environment,
        *,
        program=PROGRAM,
        deployment=DEPLOYMENT,
        land=BRISK,
        within=60.0,
        stay="1000",
        heap="1 MiB",
        options=(),
        **started,
    ):
        self._lfield, self.environment = lfield, environment
        endpoint = copter(lfield, environment, land)
        bound = devices({"lead": endpoint}, within, heap)
        file = lfield.mission(program, deployment.format(stay=stay), bound)
        self.command = ("--deploy", file, *lfield.maps(["alpha"]))
        started = {**started, "env": {**environment, **started.get("env", {})}}
        self.host = lfield.start("up", *self.command, "--host", "alpha", *options, **started)
        self.witness = MavlinkObserver(endpoint)
        self.witness.until(lambda seen: seen.height > 2.0 and seen.armed)

    @property
    def address(self) -> tuple[str, int]:
        """The address of the host."""
        host, _, port = self.command[-1].partition("=")[2].rpartition(":")
        return host, int(port)

    @property
    def guard(self) -> int:
        """The pid of the guard."""
        guards = self._lfield.guards()
        assert guards, self.host.said
        return guards[0]

    def kill_guard(self) -> None:
        """Kill the guard."""
        os.kill(self.guard, signal.SIGKILL)

    def has_a_guard_again(self, *, after: int) -> None:
        """Wait for a new guard process."""
        end = time.monotonic() + BOUND
        while not set(self._lfield.guards()) - {after}:
            assert time.monotonic() < end, self.host.said
            time.sleep(0.05)

    def ask(self, *arguments: str):
        """Send a command to the host; returns its output and exit status."""
        return self._lfield(*arguments[:1], *self.command, *arguments[1:], env=self.environment)

    def fault(self, *settings: str) -> None:
        output = self._lfield("sim", "fault", "mavlink", *settings, env=self.environment)
        assert self._lfield.status(output) == 0, output.said

    def is_down(self) -> None:
        """Assert that the copter is on the ground; the report of stopped motors may be one heartbeat late."""
        self.witness.catch_up()
        assert self.witness.height < 0.3
        self.landed()

    def landed(self) -> None:
        """Wait until the vehicle reports that it has landed with its motors off."""
        landed(self.witness)
