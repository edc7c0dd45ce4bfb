"""MAVLink mission protocol: upload and download of plans; every upload is read back and compared.

In an upload the vehicle requests item after item, repeats lost requests, and ends with an acknowledgement.
The acknowledgement alone is not sufficient, since lost and repeated packets can truncate a plan (MAVSDK
#1745): the plan is downloaded and compared.

https://mavlink.io/en/services/mission.html; measured: ArduPilot uses the deprecated MISSION_REQUEST and
stores home as item 0 of its missions.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from lfield.driver import DeviceError
from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.services.peer import Inbox, Peer
from lfield_mavlink.services.plan_items import HOME, Item, PlanKind
from lfield_mavlink.services.plan_upload import MAX_SILENCES, MAX_SILENCES_WITHIN, REQUESTS, Upload

T = TypeVar("T")

#: Seconds to wait for an answer.
ANSWER_TIMEOUT = 0.5
#: Attempts for an upload.
ATTEMPTS = 3
#: Maximum number of downloaded items.
MAX_ITEMS = 5000

_ACK = dialect.MAVLINK_MSG_ID_MISSION_ACK
_COUNT = dialect.MAVLINK_MSG_ID_MISSION_COUNT
_ITEM = dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT
_ACCEPTED = dialect.MAV_MISSION_ACCEPTED
_CANCELLED = dialect.MAV_MISSION_OPERATION_CANCELLED


class PlanTransfer:
    """The plans of one vehicle; one transfer at a time.

    `home_first` returns whether its missions start with home; called for each transfer, since the autopilot
    is not known at first.
    """

    def __init__(self, peer: Peer, home_first: Callable[[], bool]) -> None:
        self._peer, self._home_first = peer, home_first
        self._inbox = Inbox(peer, _ACK, _COUNT, _ITEM, *REQUESTS)
        self._lock = asyncio.Lock()

    async def upload(self, kind: PlanKind, items: Sequence[Item]) -> None:
        """Replaces a plan on the vehicle. Raises DeviceError.

        On return the vehicle was verified to have exactly this plan. ArduPilot overwrites a mission item by
        item: if it refuses one, it has none afterwards.
        """
        wire = [HOME, *items] if self._has_home(kind) else list(items)
        async with self._lock:
            try:
                await self._run(kind, self._upload(kind, wire))
            except DeviceError as error:
                if self._has_home(kind) and error.kind != "DeviceTimeoutException":
                    with suppress(DeviceError):
                        await self._run(kind, self._upload(kind, [HOME]))
                raise

    async def download(self, kind: PlanKind) -> list[Item]:
        """The plan on the vehicle, without home. Raises DeviceError."""
        async with self._lock:
            items = await self._run(kind, self._download(kind))
        return items[1:] if self._has_home(kind) else items

    async def clear(self, kind: PlanKind) -> None:
        """Removes the plan from the vehicle, and verifies it. Raises DeviceError."""
        if self._has_home(kind):
            await self.upload(kind, [])
            return
        async with self._lock:
            await self._run(kind, self._clear(kind))

    def _has_home(self, kind: PlanKind) -> bool:
        return kind is PlanKind.MISSION and self._home_first()

    async def _run(self, kind: PlanKind, operation: Coroutine[Any, Any, T]) -> T:
        """Runs a part of the protocol; sends a cancellation to the vehicle if it ends early."""
        with self._inbox.open() as self._mail:
            try:
                return await operation
            except BaseException:
                self._peer.send(self._ack(kind, _CANCELLED))
                raise

    # -- upload ---------------------------------------------------------------------------------------

    async def _upload(self, kind: PlanKind, wire: Sequence[Item]) -> None:
        skip = 1 if self._has_home(kind) else 0
        reason = ""
        for _ in range(ATTEMPTS):
            reason = await self._offer(kind, wire)
            if reason:
                continue
            stored = await self._download(kind)
            if _are_equal(wire[skip:], stored[skip:]):
                return
            reason = f"it has {len(stored)} items, which are not the {len(wire)} sent"
        raise self._peer.error(f"the {kind.noun} could not be uploaded in {ATTEMPTS} attempts: {reason}")

    async def _offer(self, kind: PlanKind, wire: Sequence[Item]) -> str:
        """Sends a plan; returns the reason of a failure, or '' when the vehicle has requested every item."""
        upload = Upload(self._peer.system, kind, wire)
        self._peer.send(upload.last)
        while not upload.is_over:
            message = await self._mail.find(lambda m: _is_of(m, kind), ANSWER_TIMEOUT)
            now = asyncio.get_running_loop().time()
            answer = upload.on_silence() if message is None else upload.on_message(message, now)
            if answer is not None:
                self._peer.send(answer)
        if upload.refusal is not None:
            reason = mission_result_text(upload.refusal)
            raise self._peer.error(f"the autopilot refuses the {kind.noun}: {reason}")
        if upload.is_silent:
            raise self._peer.error(f"uploading the {kind.noun}: the autopilot did not answer", timeout=True)
        return upload.reason

    # -- download and clear -----------------------------------------------------------------------------

    async def _download(self, kind: PlanKind) -> list[Item]:
        system = self._peer.system
        ask_list = dialect.MAVLink_mission_request_list_message(system, AUTOPILOT, int(kind))
        answer = await self._request(kind, ask_list, lambda m: m.get_msgId() == _COUNT or _has_none(m))
        count: int = 0 if answer.get_msgId() == _ACK else answer.count
        if count > MAX_ITEMS:
            raise self._peer.error(f"its {kind.noun} has {count} items, more than {MAX_ITEMS}")
        items = [await self._item(kind, number) for number in range(count)]
        self._peer.send(self._ack(kind, _ACCEPTED))
        return items

    async def _item(self, kind: PlanKind, number: int) -> Item:
        ask = dialect.MAVLink_mission_request_int_message(self._peer.system, AUTOPILOT, number, int(kind))
        # More attempts within a download, since the vehicle does respond.
        return Item.from_message(
            await self._request(
                kind, ask, lambda m: m.get_msgId() == _ITEM and m.seq == number, MAX_SILENCES_WITHIN
            )
        )

    async def _clear(self, kind: PlanKind) -> None:
        clear = dialect.MAVLink_mission_clear_all_message(self._peer.system, AUTOPILOT, int(kind))
        await self._request(kind, clear, lambda m: m.get_msgId() == _ACK and m.type == _ACCEPTED)
        if remaining := len(await self._download(kind)):
            raise self._peer.error(f"the {kind.noun} was cleared, but {remaining} of its items remain")

    async def _request(
        self, kind: PlanKind, request: Any, answers: Callable[[Any], bool], times: int = MAX_SILENCES
    ) -> Any:
        """Repeats a request until it is answered. Raises DeviceError with the refusal, if any."""
        refusal: list[int] = []

        def matches(message: Any) -> bool:
            if not _is_of(message, kind):
                return False
            if message.get_msgId() == _ACK and message.type != _ACCEPTED:
                refusal.append(message.type)
            return answers(message)

        for _ in range(times):
            self._peer.send(request)
            if (answer := await self._mail.find(matches, ANSWER_TIMEOUT)) is not None:
                return answer
        if refusal:
            reason = mission_result_text(refusal[-1])
            raise self._peer.error(f"the autopilot refuses to send its {kind.noun}: {reason}")
        raise self._peer.error(f"reading the {kind.noun}: the autopilot did not answer", timeout=True)

    def _ack(self, kind: PlanKind, result: int) -> Any:
        return dialect.MAVLink_mission_ack_message(self._peer.system, AUTOPILOT, result, int(kind))


def mission_result_text(result: int) -> str:
    """`NO_SPACE (4)`."""
    entry = dialect.enums["MAV_MISSION_RESULT"].get(result)
    name = entry.name.removeprefix("MAV_MISSION_") if entry is not None else "unknown result"
    return f"{name} ({result})"


def _has_none(message: Any) -> bool:
    """Whether a message is the answer of an autopilot without rally points."""
    is_refusal = message.get_msgId() == _ACK and message.type == dialect.MAV_MISSION_UNSUPPORTED
    return bool(is_refusal and message.mission_type == PlanKind.RALLY)


def _is_of(message: Any, kind: PlanKind) -> bool:
    return bool(message.mission_type == kind)


def _are_equal(expected: Sequence[Item], received: Sequence[Item]) -> bool:
    return len(expected) == len(received) and all(map(Item.matches, expected, received))
