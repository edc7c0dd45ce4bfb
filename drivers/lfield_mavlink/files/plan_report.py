"""Reads a mission file and checks it for a vehicle: all findings, not the first. Pure.

The height of a return and the default radius of circles are settings of the vehicle: they are checked here if
the options state them, and in any case when the plan is uploaded, with its real home.
"""

from __future__ import annotations

import codecs
import math
from collections.abc import Iterator, Mapping

from msgspec import structs
from msgspec.structs import replace

from lfield.driver import DeviceBinding, DeviceError, FileFinding, MissionFileError, PlanReport, PlanRequest
from lfield_mavlink.files.fence_check import FenceCheck
from lfield_mavlink.files.plan_file import FIRMWARES, PlanFile
from lfield_mavlink.files.plan_path import PlanPath, lands, placed_items
from lfield_mavlink.files.qgc_plan import read_plan as read_qgc_plan
from lfield_mavlink.files.waypoint_file import read_waypoints
from lfield_mavlink.geodesy import Place
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.mission_check import Climb, MissionCheck, Situation
from lfield_mavlink.services.mission_commands import is_flown, starts_with_takeoff
from lfield_mavlink.services.mission_rules import RULES
from lfield_mavlink.services.plan_items import RALLY_POINT, Item, command_name, place

#: The most items that a firmware stores: ArduPilot 15 bytes each in 64 kB of a microSD card (BRD_SD_MISSION),
#: PX4 NUM_MISSIONS_SUPPORTED of boards (navigation.h).
MOST_ITEMS: Mapping[str, int] = {"ardupilot": 4369, "px4": 500, "": 4369}
#: The number of items that an ArduPilot board stores without a microSD card.
ON_BOARD = 724
#: Metres from home to the first item that are unusual; PX4's MIS_DIST_1WP was 900 up to 1.14.
UNUSUAL_DISTANCE = 900.0
_KIND_WORDS = {"vtol": "plane that takes off vertically"}


def read_plan(name: str, data: bytes, request: PlanRequest) -> PlanReport:
    """The content of a mission file, and its defects. Raises MissionFileError."""
    return check_plan(read_plan_file(name, data), request)


def read_plan_file(name: str, data: bytes) -> PlanFile:
    """The content of a mission file; its format is detected. Raises MissionFileError."""
    head = data[:4096].removeprefix(codecs.BOM_UTF8).lstrip()
    if not head:
        raise MissionFileError(name, "it is empty")
    if head.startswith(b"QGC"):
        return read_waypoints(name, data)
    if head.startswith((b"{", codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return read_qgc_plan(name, data)
    raise MissionFileError(name, "it is neither a plan of QGroundControl nor a 'QGC WPL' file")


def check_plan(plan: PlanFile, request: PlanRequest) -> PlanReport:
    """The report about a plan that was read."""
    if request.home is not None:
        plan = replace(plan, home=Place(*request.home))
    request = _of_options(request)
    check = _PlanCheck(plan, request)
    path = check.path
    limit = request.limits.get("speed", math.inf)
    return PlanReport(
        tuple(check.findings()),
        plan.kind,
        plan.firmware,
        len(plan.items),
        path.length(),
        duration=path.duration(check.kind, limit),
        highest=path.highest(),
        farthest=path.farthest(),
        home=None if path.home is None else path.home.position,
        path=tuple(path.points),
        zones=plan.fence,
        rally=tuple((point.latitude, point.longitude) for point in plan.rally),
        areas=plan.areas,
    )


def _of_options(request: PlanRequest) -> PlanRequest:
    """The request with kind and firmware of the options of a binding."""
    kind, firmware = (str(request.options.get(key, "")) for key in ("kind", "autopilot"))
    known_firmware = firmware if firmware in FIRMWARES else ""
    return structs.replace(request, kind=request.kind or kind, firmware=request.firmware or known_firmware)


class _PlanCheck:
    """Collects the findings of one plan."""

    def __init__(self, plan: PlanFile, request: PlanRequest) -> None:
        self._plan, self._request = plan, request
        self.kind = request.kind or plan.kind or "copter"
        self._firmware = request.firmware or plan.firmware
        self.path = PlanPath(plan, px4=self._firmware == "px4")
        self._limits = _limits(request.limits)

    def findings(self) -> Iterator[FileFinding]:
        """All findings: about the file as a whole, then by item, then about rally points."""
        yield from self._made_for()
        count, maximum = len(self._plan.items), MOST_ITEMS[self._firmware]
        if not count and not (self._plan.fence or self._plan.rally):
            yield FileFinding("M105", "the plan has no items")
        if count > maximum:
            subject = f"{self._firmware or 'any firmware'} stores"
            yield FileFinding("M105", f"the plan has {count} items, and {subject} at most {maximum}")
            return
        if count > ON_BOARD:
            text = f"the plan has {count} items; ArduPilot stores more than {ON_BOARD} on a microSD card only"
            yield FileFinding("M902", text)
        if self._limits.bound_places and self._plan.home is None:
            text = "the plan has no home, to which altitude and radius refer: set the planned home in it"
            yield FileFinding("M109", f"{text} ('lfield plan check' has --home)")
            return
        fence = FenceCheck(self._plan.fence, self.path, self._firmware)
        yield from fence.zone_findings()
        yield from self._start()
        yield from sorted(
            [*self._items(), *self._below_home(), *fence.path_findings()], key=lambda each: each.item or 0
        )
        yield from self._rally(fence)

    def _made_for(self) -> Iterator[FileFinding]:
        """Findings about another kind of vehicle or firmware. The kind `plane` of a request includes planes
        that take off vertically, as in a binding.
        """
        requested, kind = self._request.kind, self._plan.kind
        if requested and kind and kind != requested and (requested, kind) != ("plane", "vtol"):
            plan_kind, requested_kind = (_KIND_WORDS.get(each, each) for each in (kind, requested))
            yield FileFinding("M101", f"the plan was made for a {plan_kind}, not for a {requested_kind}")
        requested, firmware = self._request.firmware, self._plan.firmware
        if requested and firmware and firmware != requested:
            yield FileFinding("M102", f"the plan was made for {firmware}, not for {requested}")

    def _start(self) -> Iterator[FileFinding]:
        items = [each.item for each in self._plan.items]
        flies = self.kind not in ("rover", "submarine")
        if items and flies and not starts_with_takeoff(items):
            number = next((each.number for each in self._plan.items if is_flown(each.item.command)), None)
            text = "the plan does not begin with a takeoff"
            yield FileFinding(
                "M108", text + (f", but with item {number}" if number is not None else ""), number
            )
        first = next(iter(self.path.points), None)
        if (
            first is not None
            and self.path.home is not None
            and (distance := self.path.from_home(first)) > UNUSUAL_DISTANCE
        ):
            yield FileFinding("M901", f"item {first.item} is {distance:.0f} m from home", first.item)

    def _items(self) -> Iterator[FileFinding]:
        """The findings by the rules that apply to uploads too."""
        plan, enums = self._plan, dialect.enums["MAV_CMD"]
        items = [each.item for each in plan.items]
        check = MissionCheck("", items, self._limits, _error, self._situation())
        for index, each in enumerate(plan.items):
            if each.item.command not in enums:
                text = f"item {each.number}: no autopilot knows the command {each.item.command}"
                yield FileFinding("M103", text + self._within(each.part_of), each.number)
                continue
            try:
                check.structure(index, each.item)
                if self._limits.bounds_anything:
                    RULES.get(each.item.command, MissionCheck.refuse)(check, index, each.item)
            except DeviceError as error:
                yield FileFinding("M104", error.reason + self._within(each.part_of), each.number)

    def _situation(self) -> Situation:
        kind = "plane" if self.kind == "vtol" else self.kind
        first = self._plan.items[0].number if self._plan.items else 1
        radius, height = (self._stated(name) for name in ("circle_radius", "return_height"))
        climb = Climb(height, "return_height")
        return Situation(
            kind, self._firmware == "px4", self._plan.home, None, radius, climb, first_number=first
        )

    def _stated(self, name: str) -> float:
        """An option in metres; 0 if it is not stated."""
        value = self._request.options.get(name, 0.0)
        return float(value) if isinstance(value, int | float) else 0.0

    def _within(self, part_of: str) -> str:
        return f" (of the {part_of})" if part_of else ""

    def _below_home(self) -> Iterator[FileFinding]:
        if self.kind in ("rover", "submarine"):
            return
        for each in placed_items(self._plan.items):
            height = self.path.height(each.item)
            if height is not None and height < 0.0 and not lands(each.item):
                text = f"item {each.number}, {command_name(each.item.command)}, is {-height:g} m below home"
                yield FileFinding("M107", text + self._within(each.part_of), each.number)

    def _rally(self, fence: FenceCheck) -> Iterator[FileFinding]:
        check = MissionCheck("", [], self._limits, _error, self._situation())
        frame = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
        for number, point in enumerate(self._plan.rally, 1):
            try:
                check.rally_point(
                    number, Item(RALLY_POINT, frame, *place(point.latitude, point.longitude), point.height)
                )
            except DeviceError as error:
                yield FileFinding("M111", error.reason)
            if violation := fence.position_violation((point.latitude, point.longitude)):
                yield FileFinding("M111", f"rally point {number} is {violation}")


def _limits(limits: Mapping[str, float]) -> Limits:
    binding = DeviceBinding(
        agent="", field="", type="", driver="mavlink", endpoint="", safe_state="land", limits=dict(limits)
    )
    return Limits(binding, _error)


def _error(reason: str) -> DeviceError:
    return DeviceError("", reason)
