"""Data for an operator: events and states on a terminal or page, files of other programs."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from decoder_target import Target
from rich.console import Console
from targets_of_links import TOKENS, example, pack, sealed, unpack

from lfield.cli.views import event_view, team_state_view, team_status_view
from lfield.client.event_json import event_json
from lfield.client.status_json import status_data
from lfield.driver import MissionFileError, PlanRequest
from lfield.errors import LfieldError, WireError
from lfield.geodata.area_file import check_shape, is_area_file, read_area_file
from lfield.geodata.plan_drawing import draw_plan
from lfield.operator.dashboard.event_stream.stream_cursor import StreamCursor
from lfield.operator.dashboard.timeline.event_timeline import EventTimeline
from lfield.operator.team_model.host_model import host_states
from lfield.operator.team_model.team_contents import TeamContents
from lfield.operator.team_model.team_state import HostState
from lfield.operator.team_model.team_view import TeamView
from lfield.wire import codec
from lfield.wire.events import KINDS, Event
from lfield.wire.observer_messages import Status
from lfield.wire.subscription_messages import EventBatch
from lfield_mavlink.files.parameter_facts import own_values
from lfield_mavlink.files.parameter_file import read_parameters
from lfield_mavlink.files.plan_report import read_plan
from lfield_mavlink.modes import PX4

#: Control sequences of a terminal.
_ESCAPES = ("\x1b[2J", "\x9b31m", "\u202e", "\r", "\x07", "[red]", "😀" * 50)


def decode_statuses(data: bytes) -> None:
    """Show the reported states of hosts as `lfield ps` does; the text has no control characters."""
    try:
        tree = unpack(data)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return
    answers: dict[str, Any] = {}
    for number, part in enumerate(tree[:3] if isinstance(tree, list) else ()):
        try:
            decoded = codec.decode(codec.CONTROL, sealed(pack(part)))
        except WireError as error:
            answers[f"host{number}"] = error
            continue
        if isinstance(decoded, EventBatch):
            answers[f"host{number}"] = decoded
    _shown(host_states(answers))


def _shown(hosts: Mapping[str, HostState]) -> None:
    text = io.StringIO()
    Console(file=text, width=120, markup=False, highlight=False, emoji=False).print(
        team_status_view.team_tables(hosts)
    )
    _require_plain(text.getvalue())
    assert json.dumps(status_data(hosts))


def _statuses() -> Sequence[bytes]:
    plain = unpack(pack(EventBatch(7, 1, 1.7e9, 5.0, 0, 0, [], {}, example(Status))))
    return [pack([plain]), pack([plain, plain])]


def decode_batches(data: bytes) -> None:
    """Feed event batches of two hosts to the team view and the time line, and show all outputs."""
    try:
        tree = unpack(data)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return
    watching = _Views()
    for number, part in enumerate(tree[:6] if isinstance(tree, list) else ()):
        try:
            decoded = codec.decode(codec.CONTROL, sealed(pack(part)))
        except WireError:
            continue
        if isinstance(decoded, EventBatch):
            watching.decode(f"host{number % 2}", decoded, 100.0 + number)
    watching.poll()


class _Views:
    """All views of the received events."""

    def __init__(self) -> None:
        self._cursors = {f"host{n}": StreamCursor(telemetry=5.0) for n in range(2)}
        self._picture = TeamView(TeamContents("team", tuple(self._cursors)))
        self._timeline = EventTimeline()
        self._table, self._log = event_view.EventCsv(), event_view.LogLineView()

    def decode(self, host: str, batch: EventBatch, now: float) -> None:
        """Feed a batch of a host to the views."""
        fresh = self._cursors[host].accept(batch)
        pack(self._cursors[host].watch_request(batch.incarnation))
        self._picture.feed(host, fresh, now, 1.7e9, 0.1)
        for event in fresh.events:
            self._timeline.add(host, fresh.incarnation, event, now)

    def poll(self) -> None:
        """Render all views."""
        for now in (103.0, 110.0):
            self._picture.tick(now)
            text = io.StringIO()
            console = Console(file=text, width=120, markup=False, highlight=False, emoji=False)
            console.print(team_state_view.table(self._picture.snapshot(now)))
            _require_plain(text.getvalue())
        assert self._picture.curves(110.0) is not None
        for event in self._timeline.drain_events():
            lines = [event_view.event_line(event), event_json(event), *self._table.rows(event)]
            for line in self._log.lines(event):
                lines += [event_view.log_text(event, line), event_view.log_json(event, line)]
            for line in lines:
                _require_plain(line)


def _require_plain(text: str) -> None:
    assert not any(sign in text for sign in ("\x1b", "\x9b", "\x07", "\u202e", "\r"))


def _batches() -> Sequence[bytes]:
    """Batches with one event of each kind, with a snapshot and without."""
    found = []
    for number, kind in enumerate(KINDS.values(), 1):
        event = Event(number, 1.7e9, 5.0, 0, example(kind))
        batch = EventBatch(7, 1, 1.7e9, 5.0, number - 1, number, [event])
        found.append(unpack(pack(batch)))
    first = unpack(pack(EventBatch(7, 1, 1.7e9, 5.0, 0, 0, [], {"state": 2}, example(Status))))
    hop = found[[kind.__name__ for kind in KINDS.values()].index("MigrationStarted")]
    return [pack([first, each, hop, first]) for each in found]


# -- files of ground stations and map programs ---------------------------------------------------------

FILES = Path(__file__).parents[1] / "mavlink" / "files"
_HOME = (47.3977419, 8.545594, 488.0)
_REQUEST = PlanRequest("copter", "px4", {"altitude": 30.0, "radius": 100.0, "speed": 5.0}, _HOME)

WAYPOINTS = b"""QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.3977419\t8.545594\t488.0\t1
1\t0\t3\t22\t0\t0\t0\t0\t47.3977419\t8.545594\t10.0\t1
2\t0\t3\t82\t0\t0\t0\t0\t47.3980\t8.5460\t10.0\t1
3\t0\t2\t177\t1\t2\t0\t0\t0\t0\t0\t1
4\t0\t3\t5001\t3\t0\t0\t0\t47.39\t8.54\t0\t1
5\t0\t3\t5001\t3\t0\t0\t0\t47.40\t8.54\t0\t1
6\t0\t3\t5001\t3\t0\t0\t0\t47.40\t8.55\t0\t1
7\t0\t3\t5100\t0\t0\t0\t0\t47.3980\t8.5460\t10.0\t1
"""
GEOJSON = b"""{"type": "FeatureCollection", "features": [
 {"type": "Feature", "properties": {"name": "field"}, "geometry": {"type": "Polygon", "coordinates":
  [[[8.5, 47.3, 1], [8.6, 47.3], [8.6, 47.4], [8.5, 47.3]], [[8.51, 47.31], [8.52, 47.31], [8.52, 47.32]]]}},
 {"type": "Feature", "geometry": {"type": "GeometryCollection", "geometries":
  [{"type": "MultiLineString", "coordinates": [[[8.5, 47.3], [8.6, 47.3]]]}]}}]}
"""


def decode_plan(data: bytes) -> None:
    """Decode a mission file, check it and draw it."""
    try:
        report = read_plan("f.plan", data, _REQUEST)
    except MissionFileError as error:
        str(error)
        return
    if report.path or report.rally or report.home is not None:
        draw_plan(report, "f.plan")


PARAMETERS = b"""# Stack: PX4 Pro
# Vehicle: Quadrotor
1\t1\tMPC_XY_VEL_MAX\t12.5\t9
RTL_ALT,1500 # a reason
STAT_BOOTCNT 3 @READONLY
"""


def decode_parameters(data: bytes) -> None:
    """Decode a parameter file."""
    try:
        content = read_parameters("f.param", data)
    except MissionFileError as error:
        str(error)
        return
    own_values(PX4, content.values)


def decode_area(data: bytes) -> None:
    """Decode a map file, and check each of its shapes."""
    is_area_file("f.geojson", data)
    try:
        shapes = read_area_file("f.geojson", data)
    except LfieldError as error:
        str(error)
        return
    for shape in shapes[:20]:
        if shape.corners:
            draw_plan(check_shape(shape, _REQUEST), shape.label)


_OF_PLANS = (
    "null",
    "NaN",
    "1e999",
    "-1",
    "65536",
    "{",
    "}",
    "[",
    "]",
    '"',
    "SimpleItem",
    "ComplexItem",
    "survey",
)
_OF_PLANS += ("StructureScan", "fwLandingPattern", "177", "\ufeff", "9" * 40)
_OF_ROWS = ("\t", "\n", "nan", "inf", "-1", "1e308", "5001", "5004", "82", "#", "QGC WPL 120", "9" * 40)
_OF_MAPS = (
    "<",
    ">",
    "</",
    ",",
    " ",
    "nan",
    "181",
    "<!DOCTYPE x [",
    "&x;",
    "<Placemark>",
    "<Polygon>",
    "</Polygon>",
)
_OF_MAPS += ("<coordinates>", "</coordinates>", "<innerBoundaryIs>", "<LinearRing>", "null", "[", "]", "-180")

TARGETS = (
    Target("ps", _statuses, decode_statuses, True, (*TOKENS, *_ESCAPES)),
    Target("events", _batches, decode_batches, True, (*TOKENS, *_ESCAPES)),
    Target(
        "plan", lambda: [(FILES / "north-field.plan").read_bytes()], decode_plan, tokens=_OF_PLANS, share=2
    ),
    Target("parameters", lambda: [PARAMETERS], decode_parameters, tokens=_OF_ROWS),
    Target("waypoints", lambda: [WAYPOINTS], decode_plan, tokens=_OF_ROWS),
    Target("kml", lambda: [(FILES / "north.kml").read_bytes()], decode_area, tokens=_OF_MAPS),
    Target("geojson", lambda: [GEOJSON], decode_area, tokens=_OF_MAPS),
)
