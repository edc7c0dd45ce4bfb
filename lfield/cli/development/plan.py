"""`lfield plan`: checks and draws mission and area files of ground stations and map programs."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.action_help import action_help
from lfield.errors import UsageError
from lfield.text.number_arguments import real_above_0

if TYPE_CHECKING:
    from lfield.geodata.mission_files import PlanReport, PlanRequest

#: Vehicles of the option --kind; a driver refuses an unknown one.
KINDS = ("copter", "plane", "vtol", "rover", "submarine")
_LIMITS = ("altitude", "radius", "speed")
#: Settings of the autopilot, by the names of the options of a binding.
_SETTINGS = ("return_height", "circle_radius")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = actions.add_parser("check", **action_help("report every fault of a mission or area file"))
    _add_file(check)
    check.add_argument(
        "--kind", choices=KINDS, default="", help="kind of vehicle that flies or drives the plan"
    )
    check.add_argument(
        "--firmware", choices=("ardupilot", "px4"), default="", help="firmware of the autopilot"
    )
    check.add_argument(
        "--altitude",
        type=real_above_0(1e6, "metres"),
        metavar="M",
        help="limit of the height above home in metres",
    )
    check.add_argument(
        "--radius",
        type=real_above_0(1e6, "metres"),
        metavar="M",
        help="limit of the distance from home in metres",
    )
    check.add_argument(
        "--speed", type=real_above_0(1e3), metavar="M/S", help="limit of the speed over ground in m/s"
    )
    check.add_argument(
        "--return-height",
        type=real_above_0(1e4, "metres"),
        metavar="M",
        help="height of the autopilot's return above home in metres (RTL_ALT and others)",
    )
    check.add_argument(
        "--circle-radius",
        type=real_above_0(1e4, "metres"),
        metavar="M",
        help="radius of circles without one in the plan, in metres (WP_LOITER_RAD and others)",
    )
    check.add_argument("--json", action="store_true", help="print the report as one JSON object")
    show = actions.add_parser("show", **action_help("draw a mission or area file as SVG"))
    _add_file(show)
    show.add_argument("--out", metavar="FILE", type=Path, required=True, help="the SVG file to write")


def _add_file(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", metavar="FILE", type=Path, help="a .plan, a QGC WPL file (.waypoints, .txt), KML, or GeoJSON"
    )
    parser.add_argument(
        "--name", default="", help="polygon or line of a file with several, by name or number"
    )
    parser.add_argument(
        "--home",
        metavar="LAT,LON[,ALT]",
        type=_home,
        help="home instead of the one in the file; ALT above sea level",
    )


def run(args: argparse.Namespace) -> int:
    """Returns 0; `check` returns 65 when the file has faults."""
    from lfield.geodata.area_file import is_area_file
    from lfield.text.input_files import MAX_TEXT, read_bytes

    name, data = str(args.file), read_bytes(args.file, MAX_TEXT)
    arguments = {} if args.action == "show" else {each: getattr(args, each) for each in _LIMITS}
    limits = {each: value for each, value in arguments.items() if value is not None}
    is_area = is_area_file(name, data)
    if args.name and not is_area:
        raise UsageError("--name is for a KML or GeoJSON file")
    report = _area_report(args, name, data, limits) if is_area else _plan_report(args, name, data, limits)
    if args.action == "show":
        return _show(args, report)
    if args.json:
        print(json.dumps(_as_data(name, report)))
    else:
        for finding in report.findings:
            print(finding.render(name))
        print(_summary(name, report, is_area=is_area))
    return exit_status.DONE if report.is_usable else exit_status.DATA


def _plan_report(args: argparse.Namespace, name: str, data: bytes, limits: dict[str, float]) -> PlanReport:
    from lfield.driver.plugins import discover

    return discover().plan_reader.read_plan(name, data, _request(args, limits))


def _request(args: argparse.Namespace, limits: dict[str, float]) -> PlanRequest:
    from lfield.geodata.mission_files import PlanRequest

    kind, firmware = (getattr(args, each, "") for each in ("kind", "firmware"))
    settings = {each: getattr(args, each, None) or 0.0 for each in _SETTINGS}
    return PlanRequest(kind, firmware, limits, args.home, settings)


def _area_report(args: argparse.Namespace, name: str, data: bytes, limits: dict[str, float]) -> PlanReport:
    from lfield.geodata.area_file import check_shape, read_area_file
    from lfield.geodata.shapes import chosen_shape

    if "radius" in limits and args.home is None:
        raise UsageError("an area file has no home, to which --radius refers: give --home too")
    shape = chosen_shape(name, read_area_file(name, data), args.name)
    return check_shape(shape, _request(args, limits))


def _show(args: argparse.Namespace, report: PlanReport) -> int:
    from lfield.cli.output_files import write_bytes
    from lfield.geodata.plan_drawing import draw_plan

    try:
        drawing = draw_plan(report, args.file.name)
    except ValueError as error:
        from lfield.errors import MissionFileError

        raise MissionFileError(str(args.file), str(error)) from None
    write_bytes(args.out, drawing.encode())
    print(f"{args.out}: drawn")
    return exit_status.DONE


def _summary(name: str, report: PlanReport, *, is_area: bool) -> str:
    parts = [] if is_area else [_count(report.items, "item")]
    if is_area:
        shape = "an area" if report.areas else "a line"
        parts.append(
            f"{shape} with {_count(len(report.areas[0] if report.areas else report.path), 'corner')}"
        )
    parts.append(f"{report.extent:.0f} m2" if report.extent else f"{report.length:.0f} m")
    if report.highest is not None:
        parts.append(f"highest {report.highest[0]:g} m (item {report.highest[1]})")
    if report.farthest is not None:
        noun = "corner" if is_area else "item"
        parts.append(f"farthest {report.farthest[0]:.0f} m from home ({noun} {report.farthest[1]})")
    if report.duration:
        parts.append(f"about {math.ceil(report.duration / 60.0)} min")
    if not is_area:
        parts.append(f"fence of {_count(len(report.zones), 'zone')}" if report.zones else "no fence")
        parts.append(_count(len(report.rally), "rally point"))
    if faults := sum(finding.is_error for finding in report.findings):
        parts.append(_count(faults, "fault"))
    return f"{name}: {', '.join(parts)}"


def _count(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _as_data(name: str, report: PlanReport) -> dict[str, object]:
    def placed(value: tuple[float, int] | None) -> dict[str, float] | None:
        return None if value is None else {"metres": value[0], "item": value[1]}

    return {
        "file": name,
        "kind": report.kind,
        "firmware": report.firmware,
        "items": report.items,
        "length": report.length,
        "extent": report.extent,
        "duration": report.duration,
        "highest": placed(report.highest),
        "farthest": placed(report.farthest),
        "home": report.home,
        "fence": len(report.zones),
        "rally": len(report.rally),
        "findings": [finding.as_data() for finding in report.findings],
    }


def _home(text: str) -> tuple[float, float, float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    latitude, longitude, altitude = (*values, 0.0)[:3] if 2 <= len(values) <= 3 else (math.nan,) * 3
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and math.isfinite(altitude)):
        raise argparse.ArgumentTypeError(f"must be LATITUDE,LONGITUDE in degrees, not '{text}'")
    return latitude, longitude, altitude
