"""Recordings of real autopilots, read by the monitors of a vehicle in the vehicle's own time."""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from lfield.clock import ManualClock
from lfield.testing.driver_bench import bind
from lfield.testing.kept_reports import KeptReports
from lfield_mavlink import PLUGIN
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.setpoints.motion_orders import Order
from lfield_mavlink.vehicle import MavlinkVehicle

OWN, OTHERS = Path(__file__).parent / "traces", Path(__file__).parents[2] / "sim" / "replay" / "traces"
#: The message types that the monitors read; fields that a recording omits become 0.
NAMES = {
    name: getattr(dialect, f"MAVLink_{name.lower()}_message")
    for name in (
        "HEARTBEAT", "CURRENT_MODE", "LOCAL_POSITION_NED", "ATTITUDE", "STATUSTEXT", "GPS_RAW_INT",
        "EXTENDED_SYS_STATE", "EKF_STATUS_REPORT", "ESTIMATOR_STATUS", "HOME_POSITION", "GPS_GLOBAL_ORIGIN",
    )
}  # fmt: skip


class Event(NamedTuple):
    """A note of the recorder, or a message; `at` is the vehicle's own clock, in seconds."""

    at: float
    note: str = ""
    message: Any = None


def _message(kind: Any, fields: dict[str, Any]) -> Any:
    given = {
        name: math.nan if fields.get(name, 0) is None else fields.get(name, 0) for name in kind.fieldnames
    }
    if "text" in given:
        given["text"] = str(given["text"]).encode("ascii", "replace")
    for name in ("q", "covariance"):
        if name in given:
            given[name] = [1.0, 0.0, 0.0, 0.0]
    return kind(**given)


def events(name: str) -> Iterator[Event]:
    """The recorded events, in order."""
    paths = [folder / f"{name}.jsonl.gz" for folder in (OWN, OTHERS)]
    path = next(path for path in paths if path.exists())
    now, booted = 0.0, None
    with gzip.open(path, "rt") as lines:
        next(lines)
        for line in lines:
            each = json.loads(line)
            if each["dir"] == "note":
                yield Event(now, each["text"])
                continue
            if each["dir"] != "out" or each.get("comp") != 1 or each["type"] not in NAMES:
                continue
            fields = each["fields"]
            if "time_boot_ms" in fields:
                boot = fields["time_boot_ms"] / 1000.0
                if booted is not None:
                    now += boot - booted if boot >= booted else 0.1
                booted = boot
            yield Event(now, "", _message(NAMES[each["type"]], fields))


class Watched:
    """A passive vehicle of the driver; `goals` are the goals of a patrol in turn, in metres from home."""

    def __init__(self, name: str, *goals: tuple[float, float, float]) -> None:
        self.name, self.goals = name, list(goals)
        self.clock, self.reports = ManualClock(0.0), KeptReports()
        px4 = name.startswith("px4")
        binding = bind(
            PLUGIN, agent="a1", field="fc", safe_state="land", endpoint="udp:127.0.0.1:1", ttl=0.5, limits={},
            options={"system": 1, "kind": "copter", "autopilot": "px4" if px4 else "ardupilot"},
            waivers=["device_watchdog"],
        )  # fmt: skip
        manifest = PLUGIN.read_manifests()[binding.type]
        self.vehicle = MavlinkVehicle(binding, manifest, self.clock, self.reports, lambda message: None)
        self.monitor = self.vehicle.motion.monitor
        self.monitor.is_ours = lambda: self._judged
        self._judged = False
        self._mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self._mode = ""
        #: The findings of the monitors: time and text.
        self.found: list[tuple[float, str]] = []

    def play(
        self, start: float = -math.inf, end: float = math.inf, *, judged: bool = True
    ) -> Iterator[Event]:
        """Plays the recording; yields each event after the monitors have processed it."""
        for event in events(self.name):
            self.clock.advance(event.at - self.clock.monotonic())
            if event.message is not None:
                event.message.pack(self._mav)
                self.vehicle.on_message(event.message)
                self._fly(judged)
                self._collect_findings(event.at)
            if start <= event.at <= end:
                yield event

    def _fly(self, judged: bool) -> None:
        """Expects what lfield commanded: a motion to a goal in the setpoint mode, else a descent."""
        state = self.vehicle.state
        if state.profile is None:
            return
        flies = state.mode in (state.profile.guided, "AUTO.LOITER") and state.landed is False and state.armed
        self._judged = judged and state.armed
        mode = "goal" if flies and self.goals else state.mode
        if mode != self._mode:
            self._mode = mode
            if mode == "goal":
                self.monitor.on_order(
                    Order(frozenset({state.mode}), target=lambda _: None, goal=self.goals[0])
                )
            else:
                # The height commanded by other stations is unknown: the vehicle may descend.
                self.monitor.on_mode(state.mode if self.goals else "")
        if mode == "goal" and state.position and math.dist(state.position[:2], self.goals[0][:2]) < 1.0:
            self.goals.append(self.goals.pop(0))
            self._mode = ""

    def _collect_findings(self, at: float) -> None:
        for words in (self.monitor.falling, self.monitor.lost_position, self.monitor.foreign):
            if words and words not in (known for _, known in self.found):
                self.found.append((at, words))
