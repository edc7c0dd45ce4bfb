"""Items of a stream in, messages in channels out; independent of the file format. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from lfield.export.channels import Channel, ChannelMessage, timestamp
from lfield.export.export_input import NO_INFO, MissionInfo, StreamItem, StreamNotice, telemetry_of
from lfield.export.foxglove_schemas import ERROR, INFO, LOG, WARNING
from lfield.export.hop_arrows import HopArrows
from lfield.export.plain_channels import SampledChannels, TelemetryChannels, event_message
from lfield.export.vehicle_track import VehicleTracker
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.operator.team_model.log_buffer import LineAssembler, lines_of, lost_events_text
from lfield.wire.events import EventsDropped, LineLogged, Printed, TelemetryEvent

LINES = Channel("/log", LOG)

#: Levels by their names in events; others are of a later version.
_LEVELS = {"warning": WARNING, "error": ERROR}


class LogChannel:
    """Log lines as Foxglove's log messages; the name of a line is its host, for a program HOST/AGENT."""

    def __init__(self) -> None:
        self._assembler = LineAssembler()

    def messages(self, dated: DatedEvent) -> Iterator[ChannelMessage]:
        """The lines that are complete with an event."""
        host, time = dated.host, dated.time
        match dated.event.what:
            case Printed(agent) as what:
                for line in self._assembler.lines(host, what):
                    yield _line(time, f"{host}/{agent}", line)
            case LineLogged(text, _, level):
                for line in lines_of(text):
                    yield _line(time, host, line, _LEVELS.get(level, INFO))
            case EventsDropped(kind, count):
                lost = "lines" if kind == "printed" else f"events of kind '{kind}'"
                yield _line(time, host, lost_events_text(lost, count), WARNING)

    def notice(self, notice: StreamNotice) -> ChannelMessage:
        """A gap in the stream."""
        return _line(notice.time, notice.host, notice.text, WARNING)


def _line(time: float, name: str, text: str, level: int = INFO) -> ChannelMessage:
    data = {
        "timestamp": timestamp(time),
        "level": level,
        "message": text,
        "name": name,
        "file": "",
        "line": 0,
    }
    return ChannelMessage(LINES, time, data)


class MessageStream:
    """The messages of one team, in the order of the items."""

    def __init__(self, info: MissionInfo = NO_INFO) -> None:
        self._vehicles = VehicleTracker(info)
        self._telemetry, self._sampled = TelemetryChannels(info), SampledChannels()
        self._log, self._hops = LogChannel(), HopArrows(self._vehicles)

    def messages(self, item: StreamItem) -> Iterator[ChannelMessage]:
        """The messages of an item."""
        sample = telemetry_of(item)
        if sample is not None:
            yield from self._telemetry.messages(sample)
            yield from self._vehicles.messages(sample)
        elif isinstance(item, StreamNotice):
            yield self._log.notice(item)
        elif isinstance(item, DatedEvent) and isinstance(item.event.what, TelemetryEvent):
            yield from self._sampled.messages(item)
        elif isinstance(item, DatedEvent):
            yield event_message(item)
            yield from self._log.messages(item)
            yield from self._hops.messages(item)
