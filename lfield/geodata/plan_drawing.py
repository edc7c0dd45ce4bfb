"""Draws a mission or area file as SVG: way, item numbers, fence, rally points, area, home, legend, scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lfield.geodata.mission_files import PlanPoint, PlanReport, PlanZone, Position
from lfield.geodata.polygons import LocalPlane, circle
from lfield.geodata.svg_canvas import COLOURS, LINE, MARGIN, TEXT, Canvas, document, grid, text_at, text_width

_WAY, _EXCLUSION, _INCLUSION, _RALLY, _AREA = COLOURS[:5]
#: Pixels: width of the sign of a legend entry.
_SIGN = 28


def draw_plan(report: PlanReport, title: str) -> str:
    """The SVG of a plan. Raises ValueError if it has no position."""
    drawing = _PlanMap(report)
    parts = [
        text_at(MARGIN / 2, 24, title, "#222", weight="bold"),
        grid(drawing.canvas),
        *drawing.zones(),
        *drawing.areas(),
        *drawing.route_line(),
        *drawing.rally(),
        *drawing.home(),
        *drawing.numbers(),
        drawing.scale_bar(),
    ]
    entries = list(drawing.legend())
    height = drawing.canvas.height
    for row, (sign, text) in enumerate(entries):
        y = height + LINE * (row + 1)
        parts.append(f'<g transform="translate({MARGIN:.0f} {y - 8:.0f})">{sign}</g>')
        parts.append(text_at(MARGIN + _SIGN + 8, y - 4, text, "#555"))
    return document(drawing.canvas.width, height + LINE * (len(entries) + 1), parts)


class _PlanMap:
    """Converts the positions of a report to pixels."""

    def __init__(self, report: PlanReport) -> None:
        self._report = report
        positions = [point.position for point in report.path]
        positions += [*report.rally, *(corner for area in report.areas for corner in area)]
        if report.home is not None:
            positions.append(report.home)
        first = next((zone.corners[0] for zone in report.zones if zone.corners), None)
        origin = positions[0] if positions else first
        if origin is None:
            raise ValueError("it has no position to draw")
        self._plane = LocalPlane(*origin)
        places = [self._place(position) for position in positions]
        places += [place for zone in report.zones for place in self._outline(zone)]
        texts = [f" {point.item} {point.meaning}" for point in report.path] or [" H"]
        self.canvas = Canvas(places, texts)

    def _place(self, position: Position) -> tuple[float, float]:
        """Metres north and east."""
        east, north = self._plane.point(position)
        return north, east

    def _pixel(self, position: Position) -> tuple[float, float]:
        north, east = self._place(position)
        return self.canvas.x(east), self.canvas.y(north)

    def _outline(self, zone: PlanZone) -> list[tuple[float, float]]:
        """Metres north and east of the corners of a zone."""
        if len(zone.corners) != 1:
            return [self._place(corner) for corner in zone.corners]
        middle = self._plane.point(zone.corners[0])
        return [(north, east) for east, north in circle(middle, zone.radius)]

    def _closed(self, places: Sequence[tuple[float, float]]) -> str:
        return (
            f"M{'L'.join(f'{self.canvas.x(east):.1f} {self.canvas.y(north):.1f}' for north, east in places)}Z"
        )

    def zones(self) -> Iterator[str]:
        """Fence: green inside, red outside."""
        for zone in self._report.zones:
            if zone.corners:
                yield _filled(self._closed(self._outline(zone)), _INCLUSION if zone.inclusion else _EXCLUSION)

    def areas(self) -> Iterator[str]:
        """Areas of surveys and of map files, dashed."""
        for area in self._report.areas:
            path = self._closed([self._place(corner) for corner in area])
            yield _filled(path, _AREA, "6 4")

    def route_line(self) -> Iterator[str]:
        """The straight ways between the items, and their positions."""
        points = list(self._report.path)
        if not points:
            return
        start = [self._report.home] if self._report.home is not None else []
        pixels = [self._pixel(position) for position in (*start, *(point.position for point in points))]
        line = "L".join(f"{x:.1f} {y:.1f}" for x, y in pixels)
        yield f'<path d="M{line}" stroke="{_WAY}" stroke-width="2" stroke-linejoin="round" fill="none"/>'
        for x, y in pixels[len(start) :]:
            yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{_WAY}"/>'

    def numbers(self) -> Iterator[str]:
        """The numbers of the items; one that would hide another number is left out."""
        occupied: list[tuple[float, float, float]] = []
        for point in self._report.path:
            text = f"{point.item} {point.meaning}".strip()
            x, y = self._pixel(point.position)
            x, y, end = x + 6, y - 5, x + 6 + text_width(text)
            if any(left < end and x < right and abs(y - line) < TEXT for left, right, line in occupied):
                continue
            occupied.append((x, end, y))
            yield text_at(x, y, text, _WAY)

    def rally(self) -> Iterator[str]:
        """Rally points, with their numbers."""
        for number, position in enumerate(self._report.rally, 1):
            x, y = self._pixel(position)
            yield f'<g transform="translate({x:.1f} {y:.1f})">{_diamond()}</g>'
            yield text_at(x + 8, y + 4, f"R{number}", _RALLY)

    def home(self) -> Iterator[str]:
        """Home, a square."""
        if self._report.home is not None:
            x, y = self._pixel(self._report.home)
            yield f'<g transform="translate({x:.1f} {y:.1f})">{_square()}</g>'
            yield text_at(x - 22, y + 4, "H", "#222", weight="bold")

    def scale_bar(self) -> str:
        """A bar of one square of the grid."""
        width, y = self.canvas.step * self.canvas.scale, self.canvas.height - MARGIN / 2 + 9
        x = self.canvas.width - MARGIN / 2 - width
        bar = f'<path d="M{x:.1f} {y - 4:.1f}v8m0 -4h{width:.1f}m0 -4v8" stroke="#222" fill="none"/>'
        return bar + text_at(
            x - 8 - text_width(f"{self.canvas.step:g} m"), y + 4, f"{self.canvas.step:g} m", "#222"
        )

    def legend(self) -> Iterator[tuple[str, str]]:
        """A sign and a text for each kind of element that is drawn."""
        report = self._report
        if report.home is not None:
            yield _square(_SIGN / 2), "home (H)"
        if report.path:
            line = f'<path d="M0 0H{_SIGN}" stroke="{_WAY}" stroke-width="2"/>'
            yield line, f"way of {len(report.path)} items, with their numbers{_heights(report.path)}"
        for inclusion, colour in ((True, _INCLUSION), (False, _EXCLUSION)):
            if any(zone.inclusion == inclusion for zone in report.zones):
                yield _box(colour), "fence: stay inside" if inclusion else "fence: stay outside"
        if report.rally:
            yield _diamond(_SIGN / 2), "rally points (R)"
        if report.areas:
            yield _box(_AREA, "6 4"), "area"


def _heights(path: Sequence[PlanPoint]) -> str:
    known = [point.height for point in path if point.height is not None]
    return f", {min(known):g} to {max(known):g} m above home" if known else ""


def _filled(path: str, colour: str, dashes: str = "none") -> str:
    return (
        f'<path d="{path}" stroke="{colour}" stroke-width="1.5" stroke-dasharray="{dashes}" fill="{colour}" '
        f'fill-opacity="0.1"/>'
    )


def _box(colour: str, dashes: str = "none") -> str:
    return _filled(f"M0 -5h{_SIGN}v10h-{_SIGN}Z", colour, dashes)


def _square(x: float = 0.0) -> str:
    return f'<path d="M{x - 6:g} -6h12v12h-12Z" stroke="#222" stroke-width="2" fill="#fff"/>'


def _diamond(x: float = 0.0) -> str:
    return f'<path d="M{x:g} -7l6 7l-6 7l-6 -7Z" fill="{_RALLY}"/>'
