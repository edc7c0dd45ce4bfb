"""Mission protocol, server side: upload, download and clearing of missions, fences and rally points.

The vehicle controls an upload: it requests each item, repeats lost requests, and aborts after a time-out. PX4
replaces a plan only after a complete, valid upload. ArduPilot overwrites a mission item by item: a failed one
leaves the new items received, and as many old ones as the new count says. Pure: messages in, messages out.

Protocol: https://mavlink.io/en/services/mission.html; behaviour of both autopilots as measured.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

from msgspec import Struct, field
from msgspec.structs import replace
from pymavlink.dialects.v20 import all as dialect

from lfield_sim.mavlink.services.plan_items import (
    PlanItem,
    PlanResult,
    PlanType,
    check,
    check_fence,
    is_too_small,
)

#: mission_type of a CLEAR_ALL for every plan.
ALL = 255
#: Tolerance of accumulated steps in seconds; peers whose lists are stored.
HAIR, MAX_PEERS = 1e-6, 16

Peer = tuple[int, int]


class PlanStyle(Struct, frozen=True):
    """An autopilot's variant of the protocol.

    `home_first`: item 0 of a mission is home, instead of the uploaded one, also before the first upload.
    `old_request`: uses the deprecated MISSION_REQUEST 40. `refuses_disorder`: an item out of order ends the
    upload, instead of being requested again. `writes_at_once`: see above. `needs_list`: items are sent only
    after a list request. `cancels`: an abandoned upload gets an acknowledgement. `frames`: frames that are
    read back as others. `texts`: texts of events (`timeout`, `received`, `fence`, `invalid`, `polygon`,
    `old`). Times in seconds.
    """

    home_first: bool
    old_request: bool
    refuses_disorder: bool
    nan_means_unset: bool
    request_interval: float
    timeout: float
    capacity: Mapping[PlanType, int]
    writes_at_once: bool
    needs_list: bool
    cancels: bool
    frames: Mapping[int, int]
    texts: Mapping[str, str]


ARDUPILOT = PlanStyle(
    home_first=True,
    old_request=True,
    refuses_disorder=True,
    nan_means_unset=False,
    request_interval=1.0,
    timeout=8.0,
    capacity={PlanType.MISSION: 724, PlanType.FENCE: 84, PlanType.RALLY: 10},
    writes_at_once=True,
    needs_list=False,
    cancels=True,
    frames={5: 0, 6: 3, 11: 10},
    texts={
        "timeout": "Mission upload timeout",
        "received": "Flight plan received",
        "fence": "Fence Indexed OK",
        "polygon": "Fence validation failed",
        "old": "got MISSION_REQUEST; use MISSION_REQUEST_INT!",
    },
)
PX4 = PlanStyle(
    home_first=False,
    old_request=False,
    refuses_disorder=False,
    nan_means_unset=True,
    request_interval=0.25,
    timeout=5.0,
    capacity={PlanType.MISSION: 500, PlanType.FENCE: 32, PlanType.RALLY: 32},
    writes_at_once=False,
    needs_list=True,
    cancels=False,
    frames={0: 5, 3: 6, 10: 11},
    texts={"timeout": "Operation timeout\t", "invalid": "IGN MISSION_ITEM: Invalid item\t"},
)


class _Upload(Struct):
    """A running upload: its sender, and the time of the last message."""

    peer: Peer
    kind: PlanType
    count: int
    last_received: float
    last_request: float
    items: list[PlanItem] = field(default_factory=list)


def _nothing(_: PlanType, whole: bool) -> None:
    pass


def _silence(_: str) -> None:
    pass


class PlanProtocol:
    """The plans of one vehicle.

    `home` is item 0 of an ArduPilot mission, None without one; `on_change` is called for new plans, with
    whether they are complete; `say` sends a text.
    """

    def __init__(
        self,
        style: PlanStyle,
        home: Callable[[], PlanItem | None],
        on_change: Callable[[PlanType, bool], None] = _nothing,
        say: Callable[[str], None] = _silence,
    ) -> None:
        self._style, self._home, self._on_change, self._speak = style, home, on_change, say
        self.items: dict[PlanType, list[PlanItem]] = {kind: [] for kind in PlanType}
        #: Whether no mission was ever stored or cleared: ArduPilot then has its home as one.
        self.untouched = style.home_first
        self._listed: OrderedDict[Peer, PlanType] = OrderedDict()
        self._warned = False
        #: The current item of the mission, for downloads.
        self.current = 0
        self._upload: _Upload | None = None

    def receive(self, message: Any, now: float) -> list[Any]:
        """Answers a message of the protocol; others are ignored."""
        handler = _HANDLERS.get(message.get_msgId())
        if handler is None:
            return []
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_CLEAR_ALL and message.mission_type == ALL:
            return self._clear(_peer(message), list(PlanType), ALL)
        if message.mission_type not in (0, 1, 2):
            return [_ack(_peer(message), PlanResult.UNSUPPORTED, message.mission_type)]
        return handler(self, message, PlanType(message.mission_type), now)

    def advance(self, now: float) -> list[Any]:
        """Repeats the request for a missing item, and aborts the upload after a time-out."""
        upload = self._upload
        if upload is None:
            return []
        if now - upload.last_received > self._style.timeout - HAIR:
            self._upload = None
            self._say("timeout")
            cancelled = _ack(upload.peer, PlanResult.OPERATION_CANCELLED, upload.kind)
            return [cancelled] if self._style.cancels else []
        if now - upload.last_request > self._style.request_interval - HAIR:
            return [self._request(upload, now)]
        return []

    def forget(self) -> None:
        """Aborts an upload silently."""
        self._upload = None

    # -- uploads --------------------------------------------------------------------------------------

    def _on_count(self, message: Any, kind: PlanType, now: float) -> list[Any]:
        peer = _peer(message)
        if self._upload is not None and (self._upload.peer, self._upload.kind) != (peer, kind):
            return [_ack(peer, PlanResult.DENIED, kind)]
        self._upload = None
        if message.count > self._style.capacity[kind]:
            return [_ack(peer, PlanResult.NO_SPACE, kind)]
        if message.count == 0:
            self._say("received" if kind is PlanType.MISSION else "fence")
            return self._clear(peer, [kind], kind)
        if self._style.writes_at_once and kind is PlanType.MISSION:
            self._write(kind, self.stored(kind)[: message.count])
        self._upload = _Upload(peer, kind, message.count, now, now)
        return [self._request(self._upload, now)]

    def _on_item(self, message: Any, kind: PlanType, now: float) -> list[Any]:
        peer, upload = _peer(message), self._upload
        if upload is None or (upload.peer, upload.kind) != (peer, kind):
            return [_ack(peer, PlanResult.ERROR, kind)]
        expected = len(upload.items)
        if message.seq != expected:
            return self._out_of_turn(upload, message.seq, now)
        item = PlanItem.read(message)
        result = check(item, kind, nan_means_unset=self._style.nan_means_unset)
        if result is PlanResult.ACCEPTED and self._style.needs_list and is_too_small(item):
            result = PlanResult.ERROR
        if result is not PlanResult.ACCEPTED:
            if kind is PlanType.MISSION:
                self._say("invalid")
            return self._end(upload, result)
        upload.items.append(item)
        if self._style.writes_at_once and kind is PlanType.MISSION:
            self._write(kind, [*upload.items, *self.items[kind][len(upload.items) :]])
        upload.last_received = now
        return self._finish(upload) if len(upload.items) == upload.count else [self._request(upload, now)]

    def _out_of_turn(self, upload: _Upload, number: int, now: float) -> list[Any]:
        if number == len(upload.items) - 1:
            # The previous item again: its sender missed the following request.
            return [self._request(upload, now)]
        if self._style.refuses_disorder:
            return self._end(upload, PlanResult.INVALID_SEQUENCE)
        return [self._request(upload, now)]

    def _finish(self, upload: _Upload) -> list[Any]:
        result = check_fence(upload.items) if upload.kind is PlanType.FENCE else PlanResult.ACCEPTED
        if result is PlanResult.ACCEPTED:
            self._store(upload.kind, upload.items)
            if upload.kind is not PlanType.RALLY:
                self._say("received" if upload.kind is PlanType.MISSION else "fence")
        elif self._style.writes_at_once:
            result = self._refuse_fence(upload.items)
        return self._end(upload, result)

    def _refuse_fence(self, items: list[PlanItem]) -> PlanResult:
        """Refuses a fence: ArduPilot has one result for all mistakes, and a text with the reason."""
        corners = next((item.values[0] for item in items if is_too_small(item)), None)
        if corners is not None:
            self._speak(f"Invalid vertex count ({corners:.0f})")
        self._say("polygon")
        return PlanResult.ERROR

    def _end(self, upload: _Upload, result: PlanResult) -> list[Any]:
        self._upload = None
        return [_ack(upload.peer, result, upload.kind)]

    def _request(self, upload: _Upload, now: float) -> Any:
        upload.last_request = now
        make = dialect.MAVLink_mission_request_int_message
        if self._style.old_request:
            make = dialect.MAVLink_mission_request_message
        return make(*upload.peer, len(upload.items), int(upload.kind))

    # -- downloads and clearing -----------------------------------------------------------------------

    def _on_request_list(self, message: Any, kind: PlanType, _: float) -> list[Any]:
        peer, count = _peer(message), len(self.stored(kind))
        if self._upload is not None and self._upload.kind is kind:
            return [_ack(peer, PlanResult.DENIED, kind)]
        self._listed[peer] = kind
        self._listed.move_to_end(peer)
        if len(self._listed) > MAX_PEERS:
            self._listed.popitem(last=False)
        return [dialect.MAVLink_mission_count_message(*peer, count, int(kind))]

    def _on_request(self, message: Any, kind: PlanType, _: float) -> list[Any]:
        peer, number, items = _peer(message), message.seq, self.stored(kind)
        if self._style.needs_list and self._listed.get(peer) is not kind:
            return []
        if number >= len(items):
            refused = _ack(peer, PlanResult.INVALID_SEQUENCE, kind)
            count = dialect.MAVLink_mission_count_message(*peer, len(items), int(kind))
            return [count, refused] if self._style.home_first else [refused]
        is_home = number == 0 and kind is PlanType.MISSION and self._style.home_first
        item = (self._home() if is_home else None) or items[number]
        whole = message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT
        if not whole and not self._warned:
            self._warned = True
            self._say("old")
        # PX4 treats the first item of a fence or of rally points as current; ArduPilot never home.
        current = self.current if kind is PlanType.MISSION else 0
        is_current = number == current and not (self._style.home_first and number == 0)
        item = replace(item, frame=self._style.frames.get(item.frame, item.frame))
        return [item.write(peer, number, kind, current=is_current, whole=whole)]

    def _on_ack(self, message: Any, kind: PlanType, _: float) -> list[Any]:
        """Handles the end of a download without an action; any result but ACCEPTED cancels an upload."""
        upload = self._upload
        self._listed.pop(_peer(message), None)
        if upload is not None and (upload.peer, upload.kind) == (_peer(message), kind) and message.type:
            self._upload = None
        return []

    def _on_clear_all(self, message: Any, kind: PlanType, _: float) -> list[Any]:
        if kind is PlanType.FENCE:
            self._say("fence")
        return self._clear(_peer(message), [kind], kind)

    def _clear(self, peer: Peer, kinds: list[PlanType], acknowledged: int) -> list[Any]:
        if self._upload is not None and self._upload.peer != peer and self._upload.kind in kinds:
            return [_ack(peer, PlanResult.DENIED, acknowledged)]
        self._upload = None
        for kind in kinds:
            self._store(kind, [])
        return [_ack(peer, PlanResult.ACCEPTED, acknowledged)]

    def stored(self, kind: PlanType) -> list[PlanItem]:
        """The stored items as read back; an ArduPilot that never had a mission has its home."""
        if kind is PlanType.MISSION and self.untouched:
            home = self._home()
            return [home] if home is not None else []
        return self.items[kind]

    def _store(self, kind: PlanType, items: list[PlanItem]) -> None:
        self._write(kind, items, whole=True)

    def _write(self, kind: PlanType, items: list[PlanItem], *, whole: bool = False) -> None:
        self.items[kind] = items
        if kind is PlanType.MISSION:
            self.untouched = False
        self._on_change(kind, whole)

    def _say(self, event: str) -> None:
        if event in self._style.texts:
            self._speak(self._style.texts[event])


def _peer(message: Any) -> Peer:
    return message.get_srcSystem(), message.get_srcComponent()


def _ack(peer: Peer, result: PlanResult, kind: int) -> Any:
    return dialect.MAVLink_mission_ack_message(*peer, int(result), int(kind))


_HANDLERS: Mapping[int, Callable[[PlanProtocol, Any, PlanType, float], list[Any]]] = {
    dialect.MAVLINK_MSG_ID_MISSION_COUNT: PlanProtocol._on_count,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM: PlanProtocol._on_item,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT: PlanProtocol._on_item,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: PlanProtocol._on_request_list,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST: PlanProtocol._on_request,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT: PlanProtocol._on_request,
    dialect.MAVLINK_MSG_ID_MISSION_ACK: PlanProtocol._on_ack,
    dialect.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: PlanProtocol._on_clear_all,
}

#: Message ids of the protocol.
HANDLED = frozenset(_HANDLERS)
