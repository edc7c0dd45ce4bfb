"""Plans to and from a vehicle: the mission protocol, with every upload read back and compared.

The vehicle leads an upload: it asks for item after item, repeats its question when one is lost, and ends
with an acknowledgement. That word alone is not trusted, since lost and repeated packets can leave a plan
that is shorter than what was sent (MAVSDK #1745): the plan on the vehicle is what a download shows.

https://mavlink.io/en/services/mission.html; what the autopilots really do was measured:
ArduPilot asks with the deprecated MISSION_REQUEST and keeps home as item 0 of its missions.
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
from lfield_mavlink.services.plan_upload import QUESTIONS, REQUESTS, SILENCES, Upload

T = TypeVar("T")

#: Seconds to wait for an answer.
PATIENCE = 0.5
#: How often an upload is begun anew before it has failed.
ATTEMPTS = 3
#: The most items that are downloaded; a vehicle that says more is not believed.
MAX_ITEMS = 5000

_ACK = dialect.MAVLINK_MSG_ID_MISSION_ACK
_COUNT = dialect.MAVLINK_MSG_ID_MISSION_COUNT
_ITEM = dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT
_ACCEPTED = dialect.MAV_MISSION_ACCEPTED
_CANCELLED = dialect.MAV_MISSION_OPERATION_CANCELLED


class PlanTransfer:
    """The plans of one vehicle; one transfer at a time.

    `home_first`: whether its missions begin with home. Asked with each transfer, since it is not known
    before the vehicle was heard which autopilot it has.
    """

    def __init__(self, peer: Peer, home_first: Callable[[], bool]) -> None:
        self._peer, self._home_first = peer, home_first
        self._inbox = Inbox(peer, _ACK, _COUNT, _ITEM, *REQUESTS)
        self._lock = asyncio.Lock()

    async def upload(self, kind: PlanKind, items: Sequence[Item]) -> None:
        """Put a whole plan onto the vehicle in place of the one there. Raises DeviceError.

        When it returns, the vehicle has been seen to hold exactly this plan. ArduPilot writes a mission over
        the old one item by item: of one that it refuses, it is left with none.
        """
        wire = [HOME, *items] if self._has_home(kind) else list(items)
        async with self._lock:
            try:
                await self._guarded(kind, self._upload(kind, wire))
            except DeviceError as error:
                if self._has_home(kind) and error.kind != "DeviceTimeoutException":
                    with suppress(DeviceError):
                        await self._guarded(kind, self._upload(kind, [HOME]))
                raise

    async def download(self, kind: PlanKind) -> list[Item]:
        """The plan that the vehicle holds, without home. Raises DeviceError."""
        async with self._lock:
            items = await self._guarded(kind, self._download(kind))
        return items[1:] if self._has_home(kind) else items

    async def clear(self, kind: PlanKind) -> None:
        """Leave the vehicle without that plan, and see that it is so. Raises DeviceError."""
        if self._has_home(kind):
            await self.upload(kind, [])
            return
        async with self._lock:
            await self._guarded(kind, self._clear(kind))

    def _has_home(self, kind: PlanKind) -> bool:
        return kind is PlanKind.MISSION and self._home_first()

    async def _guarded(self, kind: PlanKind, work: Coroutine[Any, Any, T]) -> T:
        """Do a part of the protocol; when it ends early, the vehicle is told to forget it."""
        with self._inbox.open() as self._mail:
            try:
                return await work
            except BaseException:
                self._peer.send(self._ack(kind, _CANCELLED))
                raise

    # -- upload ---------------------------------------------------------------------------------------

    async def _upload(self, kind: PlanKind, wire: Sequence[Item]) -> None:
        skip = 1 if self._has_home(kind) else 0
        why = ""
        for _ in range(ATTEMPTS):
            why = await self._offer(kind, wire)
            if why:
                continue
            found = await self._download(kind)
            if _same(wire[skip:], found[skip:]):
                return
            why = f"it holds {len(found)} items that are not the {len(wire)} that were sent"
        raise self._peer.error(f"the {kind.word} could not be uploaded in {ATTEMPTS} attempts: {why}")

    async def _offer(self, kind: PlanKind, wire: Sequence[Item]) -> str:
        """Hand out a plan. Why that failed, or '' when the vehicle has asked for every item."""
        upload = Upload(self._peer.system, kind, wire)
        self._peer.send(upload.last)
        while not upload.over:
            message = await self._mail.find(lambda m: _is_of(m, kind), PATIENCE)
            now = asyncio.get_running_loop().time()
            answer = upload.on_silence() if message is None else upload.on_message(message, now)
            if answer is not None:
                self._peer.send(answer)
        if upload.refusal is not None:
            words = mission_result_words(upload.refusal)
            raise self._peer.error(f"the autopilot refuses the {kind.word}: {words}")
        if upload.silent:
            raise self._peer.error(f"uploading the {kind.word}: the autopilot did not answer", timeout=True)
        return upload.why

    # -- download and clear -----------------------------------------------------------------------------

    async def _download(self, kind: PlanKind) -> list[Item]:
        system = self._peer.system
        ask_list = dialect.MAVLink_mission_request_list_message(system, AUTOPILOT, int(kind))
        told = await self._ask(kind, ask_list, lambda m: m.get_msgId() == _COUNT or _has_none(m))
        count: int = 0 if told.get_msgId() == _ACK else told.count
        if count > MAX_ITEMS:
            raise self._peer.error(f"it says that its {kind.word} has {count} items; {MAX_ITEMS} is the most")
        items = [await self._item(kind, number) for number in range(count)]
        self._peer.send(self._ack(kind, _ACCEPTED))
        return items

    async def _item(self, kind: PlanKind, number: int) -> Item:
        ask = dialect.MAVLink_mission_request_int_message(self._peer.system, AUTOPILOT, number, int(kind))
        # In the middle of a download there is somebody who answers, so it is worth while to ask for longer.
        return Item.of(
            await self._ask(kind, ask, lambda m: m.get_msgId() == _ITEM and m.seq == number, SILENCES)
        )

    async def _clear(self, kind: PlanKind) -> None:
        clear = dialect.MAVLink_mission_clear_all_message(self._peer.system, AUTOPILOT, int(kind))
        await self._ask(kind, clear, lambda m: m.get_msgId() == _ACK and m.type == _ACCEPTED)
        if left := len(await self._download(kind)):
            raise self._peer.error(f"the {kind.word} was cleared, but {left} of its items are still there")

    async def _ask(
        self, kind: PlanKind, question: Any, answers: Callable[[Any], bool], times: int = QUESTIONS
    ) -> Any:
        """Ask until it is answered. Raises DeviceError with the refusal, when there was one."""
        refusal: list[int] = []

        def wanted(message: Any) -> bool:
            if not _is_of(message, kind):
                return False
            if message.get_msgId() == _ACK and message.type != _ACCEPTED:
                refusal.append(message.type)
            return answers(message)

        for _ in range(times):
            self._peer.send(question)
            if (answer := await self._mail.find(wanted, PATIENCE)) is not None:
                return answer
        if refusal:
            words = mission_result_words(refusal[-1])
            raise self._peer.error(f"the autopilot refuses to talk about its {kind.word}: {words}")
        raise self._peer.error(f"reading the {kind.word}: the autopilot did not answer", timeout=True)

    def _ack(self, kind: PlanKind, result: int) -> Any:
        return dialect.MAVLink_mission_ack_message(self._peer.system, AUTOPILOT, result, int(kind))


def mission_result_words(result: int) -> str:
    """`NO_SPACE (4)`."""
    entry = dialect.enums["MAV_MISSION_RESULT"].get(result)
    name = entry.name.removeprefix("MAV_MISSION_") if entry is not None else "unknown result"
    return f"{name} ({result})"


def _has_none(message: Any) -> bool:
    """Whether it answers that it has no rally points at all, as some autopilots do."""
    is_refusal = message.get_msgId() == _ACK and message.type == dialect.MAV_MISSION_UNSUPPORTED
    return bool(is_refusal and message.mission_type == PlanKind.RALLY)


def _is_of(message: Any, kind: PlanKind) -> bool:
    return bool(message.mission_type == kind)


def _same(wanted: Sequence[Item], found: Sequence[Item]) -> bool:
    return len(wanted) == len(found) and all(map(Item.same, wanted, found))
