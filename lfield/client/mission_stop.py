"""Stops the mission on the robots of an inventory in order; its coordinators may end too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lfield.client.service_desk import FleetDesk, split_answers
from lfield.errors import UsageError
from lfield.wire.service_messages import CommandResult, MissionCommand

if TYPE_CHECKING:
    from lfield.errors import LfieldError

#: Seconds for a host to end: its devices come to rest first, a vehicle in the air lands.
STOP_TIMEOUT = 300.0


@dataclass(frozen=True, slots=True)
class StopResult:
    """The result of a stop: the answers of the hosts, and the errors of those that did not answer.

    `checked` is the reason why the vehicles of a host that had ended before count as checked. `problems` are
    the hosts whose vehicles may not be at rest.
    """

    stopped: Mapping[str, CommandResult]
    errors: Mapping[str, LfieldError]
    checked: Mapping[str, str]
    problems: Sequence[str]

    def as_data(self) -> dict[str, object]:
        """The result as JSON data, as of `lfield stop --json`."""
        found: dict[str, object] = {
            host: {
                "phase": result.run.phase,
                "discarded": list(result.discarded),
                "trouble": result.trouble,
                "checked": self.checked.get(host, ""),
            }
            for host, result in self.stopped.items()
        }
        return {**found, **{host: error.as_data() for host, error in self.errors.items()}}


def hosts_to_stop(desk: FleetDesk, without: Sequence[str]) -> list[str]:
    """The hosts that are not left out. Raises UsageError."""
    desk.addresses(without)
    hosts = [host for host in desk.hosts if host not in without]
    if not hosts:
        raise UsageError("no host is left: --without names all of them")
    return hosts


async def stop_mission(desk: FleetDesk, hosts: Sequence[str], *, discards: bool = False) -> StopResult:
    """Stop the mission; with `discards` its coordinators end too, if all hosts have stopped in order."""
    order = MissionCommand("stop", is_assistant=desk.is_assistant)
    answers = await desk.order(hosts, order, CommandResult, STOP_TIMEOUT)
    stopped, failed = split_answers(answers)
    problems = [host for host, result in stopped.items() if result.trouble]
    checked = {host: result.checked for host, result in stopped.items() if result.checked}
    if discards and not failed and not problems:
        # Only when every host has stopped: a coordinator on another one could continue. And this order says
        # that the vehicles of a host that was killed meanwhile have been checked.
        order = MissionCommand("stop", discards=True, is_assistant=desk.is_assistant)
        stopped, failed = split_answers(await desk.order(hosts, order, CommandResult, STOP_TIMEOUT))
        problems = [host for host, result in stopped.items() if result.trouble]
    return StopResult(stopped, failed, checked, problems)
