"""What an operator has hosts do, and asks of them: the shell behind the buttons."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable, Mapping
from functools import cached_property, partial

from lfield.authority.identity import Identity
from lfield.authority.judge import Verdict
from lfield.authority.keys import Keys
from lfield.authority.rights import lacks
from lfield.capability.matching.matcher import Matcher
from lfield.errors import LfieldError, ProgramError
from lfield.mission.access.rules import UNWRITTEN, Access
from lfield.mission.team import Team
from lfield.net.door import oneself
from lfield.net.transport import UNIX, Transport
from lfield.operator.ask import Answers, Standing, ask_all, emergency_stop, patiently, pause, silent
from lfield.operator.observing import Brought, Request
from lfield.operator.orders.desk import Desk
from lfield.operator.query import Asked, from_hosts, views_of
from lfield.operator.question import read_question
from lfield.operator.sight.actions import Answer, Found, Order, Ordered, Witness
from lfield.operator.sight.following.reach import Reach
from lfield.wire.observing import EmergencyStop, EmergencyStopped, Pause, Status
from lfield.wire.orders import ID_SIZE

#: What each order is as a message, by which rights are looked up. None of these is sent.
_NO_ID = bytes(ID_SIZE)
_MESSAGES: Mapping[Order, EmergencyStop | Pause] = {
    "stop": EmergencyStop(_NO_ID, ""),
    "lift": EmergencyStop(_NO_ID, "", lift=True),
    "pause": Pause(_NO_ID),
    "resume": Pause(_NO_ID, lift=True),
}

Beside = Callable[[Callable[[str, Answers[Status]], Answer], str, Answers[Status]], Awaitable[Answer]]


class Orders:
    """Implements `Actions` for the hosts of a team; `witness` hears each answer as it comes.

    `keys` are those of this person, None for none; `access` is what the mission takes of their rights, as far
    as this computer knows. `asked` is what questions are about; where that cannot be had, its error says why.
    It may take a while, and is only looked for when somebody asks: what takes long is done `beside` the loop.
    Orders go over the connections that are `standing`, and as datagrams by the `desk` of the keys.
    """

    def __init__(
        self,
        transport: Transport,
        reach: Reach,
        witness: Witness,
        team: Team,
        asked: Callable[[], Asked],
        keys: Keys | None = None,
        brings: Brought | None = None,
        beside: Beside = asyncio.to_thread,
        access: Access = UNWRITTEN,
        desk: Desk | None = None,
        standing: Standing | None = None,
    ) -> None:
        self._beside = beside
        self._transport, self._reach, self._witness = transport, reach, witness
        self._team, self._read, self._keys, self._brings = team, asked, keys, brings
        self._access, self._desk, self._standing = access, desk, standing
        self._asked: Asked | None = None

    # --- who may --------------------------------------------------------------------------------------

    @property
    def barred(self) -> Mapping[Order, str]:
        """What no host would take of this person, each with a sentence."""
        found: dict[Order, str] = {}
        who = [self._oneself(address) for address in self._reach.addresses.values()]
        for order, message in _MESSAGES.items():
            reasons = [self._lacks(identity, message) for identity in who if identity is not None]
            if reasons and all(reasons):
                found[order] = reasons[0]
        return found

    def _lacks(self, who: Identity, message: EmergencyStop | Pause) -> str:
        return lacks(who, Verdict("all", barred=self._access.barred(who)), message)

    def _oneself(self, address: str) -> Identity | None:
        """Who this is to the host at an address, None where only the host knows that."""
        if not address.startswith(UNIX):
            return self._person
        try:
            return oneself(os.stat(address.removeprefix(UNIX)).st_uid)
        except OSError:
            return None

    @cached_property
    def _person(self) -> Identity | None:
        """Whom the own certificate names. What it is good for now, hosts say."""
        if self._keys is None:
            return None
        from lfield.authority.reading import identity_in

        return identity_in(self._keys.certificate, self._keys.authority)

    # --- orders ---------------------------------------------------------------------------------------

    async def stop(self, reason: str = "") -> Ordered:
        """See `Actions.stop`."""
        said = f"the emergency stop was pressed{': ' if reason else ''}{reason}"
        return await self._order("stop", emergency_stop(said))

    async def lift(self) -> Ordered:
        """See `Actions.lift`."""
        return await self._order("lift", emergency_stop("the emergency is over", lift=True))

    async def pause(self) -> Ordered:
        """See `Actions.pause`."""
        return await self._order("pause", pause())

    async def resume(self) -> Ordered:
        """See `Actions.resume`."""
        return await self._order("resume", pause(lift=True))

    async def _order(self, order: Order, request: Request[EmergencyStopped]) -> Ordered:
        confirmed: list[str] = []
        unconfirmed: dict[str, str] = {}
        unreached: dict[str, str] = {}
        troubles: dict[str, str] = {}
        addresses = dict(self._reach.addresses)
        number = self._witness.ordered(order, addresses)
        answers = await ask_all(
            self._transport,
            addresses,
            request,
            self._brings,
            self._desk,
            self._standing,
            partial(self._witness.answered, number),
        )
        for host, answer in answers.items():
            if isinstance(answer, LfieldError):
                unreached[host] = str(answer)
                continue
            confirmed += [device for device, problem in answer.devices.items() if not problem]
            unconfirmed |= {device: problem for device, problem in answer.devices.items() if problem}
            if answer.trouble:
                troubles[host] = answer.trouble
        return Ordered(order, tuple(confirmed), unconfirmed, unreached, troubles)

    # --- questions ------------------------------------------------------------------------------------

    async def query(self, text: str) -> Answer:
        """See `Actions.query`: as `lfield query --explain` does it, by what the running hosts say now."""
        answers = await ask_all(self._transport, self._reach.addresses, patiently(), self._brings)
        return await self._beside(self._matched, text, answers)

    def _matched(self, text: str, answers: Answers[Status]) -> Answer:
        try:
            asked = self._asked = self._asked or self._read()
            question = read_question(text, asked.registry)
        except ProgramError as error:
            return Answer(text, mistakes="\n".join(found.render() for found in error.diagnostics))
        except LfieldError as error:
            return Answer(text, mistakes=str(error))
        unheard = silent(answers)
        team = from_hosts(asked.registry, self._team.deployed, views_of(answers), unheard.keys())
        matcher = Matcher(asked.registry, team, asked.ways)
        units = {name: attribute.unit for name, attribute in asked.registry.attributes.items()}
        found = []
        for primitive in question.primitives:
            best = matcher.find(primitive.name, question.wish)
            refusals = matcher.explain(primitive.name, question.constraint)
            found.append(Found(primitive, best.offers, best.count, refusals, best.notes, units))
        return Answer(text, tuple(found), {host: str(why) for host, why in unheard.items()})
