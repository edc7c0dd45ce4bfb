"""The parts that the commands of a desk share: inventory, keys of the user, requests to all services."""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from lfield import exit_status
from lfield.cli.mission_argument import add_inventory
from lfield.errors import HandshakeError, KeysError, LfieldError, UsageError
from lfield.text.suggestions import did_you_mean, listed
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from lfield.authority.key_material import Keys
    from lfield.inventory.inventory import Inventory
    from lfield.operator.fleet.service_link import ServiceLinks
    from lfield.operator.observer_link import PresentedCrl
    from lfield.wire.service_messages import ServiceMessage, ServiceStatus

A = TypeVar("A", bound="ServiceMessage")
S = TypeVar("S")

#: Seconds for an answer of a service.
TIMEOUT = 8.0
#: What robots go on with after Ctrl-C during a push or a rollback.
VOTE_GOES_ON = "the robots keep what was sent, and complete a vote that has begun within 40 s"


def add_desk(parser: argparse.ArgumentParser) -> None:
    """Declare the inventory, the keys, and --json."""
    add_inventory(parser)
    parser.add_argument(
        "--keys",
        metavar="DIR",
        type=Path,
        help="directory with your keys (default: $LFIELD_KEYS, or ~/.config/lfield/keys/me)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def add_without(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare the hosts that a command leaves out."""
    parser.add_argument("--without", metavar="HOST", action="append", default=[], help=f"{what} (repeatable)")


@dataclass(frozen=True, slots=True)
class FleetDesk:
    """The inventory of a desk, and the keys of its user."""

    inventory: Inventory
    keys: Keys
    crl: PresentedCrl | None

    @property
    def hosts(self) -> list[str]:
        """All hosts, in the order of the inventory."""
        return list(self.inventory.hosts)

    def addresses(self, hosts: Sequence[str]) -> dict[str, str]:
        """The addresses of the services of some hosts. Raises UsageError for an unknown host."""
        require_hosts(self.inventory, hosts)
        return {host: self.inventory.hosts[host].service_address for host in hosts}

    @property
    def user(self) -> str:
        """The person whose keys these are."""
        from lfield.authority.certificate_reader import verify_keys

        return str(verify_keys(self.keys))

    def links(self, hosts: Sequence[str]) -> ServiceLinks:
        """Links to the services of some hosts, in the running loop. Raises UsageError for an unknown host."""
        from lfield.operator.client import observer_transport
        from lfield.operator.fleet.service_link import ServiceLinks

        transport = observer_transport(self.keys, connect_timeout=TIMEOUT)
        return ServiceLinks(transport, self.addresses(hosts), self.crl)

    def statuses(self, hosts: Sequence[str]) -> dict[str, ServiceStatus | LfieldError]:
        """The state of the services of some hosts."""
        from lfield.wire.service_messages import ServiceQuery, ServiceStatus

        return self.ask(hosts, ServiceQuery(), ServiceStatus, TIMEOUT)

    def command(
        self, hosts: Sequence[str], message: ServiceMessage, kind: type[A], timeout: float
    ) -> dict[str, A | LfieldError]:
        """As `ask`; a service that does not listen may be restarting, and is asked again."""
        from lfield.operator.fleet.service_link import RESTART_TIME

        return self.ask(hosts, message, kind, timeout, restart=RESTART_TIME)

    def ask(
        self,
        hosts: Sequence[str],
        message: ServiceMessage,
        kind: type[A],
        timeout: float,
        *,
        restart: float = 0.0,
    ) -> dict[str, A | LfieldError]:
        """The answers of the services of some hosts, or why there is none."""

        async def work() -> dict[str, A | LfieldError]:
            links = self.links(hosts)
            try:
                return await ask_all_services(links, message, kind, timeout, restart=restart)
            finally:
                links.close()

        return asyncio.run(work())


async def ask_all_services(
    links: ServiceLinks,
    message: ServiceMessage,
    kind: type[A],
    timeout: float,
    hosts: Sequence[str] | None = None,
    *,
    restart: float = 0.0,
) -> dict[str, A | LfieldError]:
    """The answers of the services of some hosts, by default of all, or why there is none.

    A service that does not listen is asked again for `restart` seconds.
    """
    asked = list(links.addresses if hosts is None else hosts)

    async def one(host: str) -> A | LfieldError:
        try:
            return await links.ask(host, message, kind, timeout, timeout, restart=restart)
        except LfieldError as error:
            return error

    return dict(zip(asked, await asyncio.gather(*map(one, asked)), strict=True))


def require_hosts(inventory: Inventory, hosts: Sequence[str]) -> None:
    """Check that the inventory has some hosts. Raises UsageError."""
    known = list(inventory.hosts)
    for host in hosts:
        if host not in known:
            hint = did_you_mean(host, known) or f"it has {listed(known)}"
            raise UsageError(f"the inventory {inventory.path} has no host '{host}': {hint}")


def open_inventory(args: argparse.Namespace) -> Inventory:
    """The inventory of a command. Raises UsageError without one, ProgramError, InputFileError."""
    from lfield.inventory.location import find_inventory

    inventory = find_inventory(args.inventory, os.environ)
    if inventory is None:
        raise UsageError(
            "no inventory: write the hosts and their addresses into ~/.config/lfield/inventory.yaml, or name "
            "the file with --inventory (lfield/docs/operations.md has an example)"
        )
    return inventory


def report_missing_files(inventory: Inventory) -> None:
    """A line on stderr for each file of the inventory that does not exist; on a robot only its own do."""
    from lfield.inventory.location import SYSTEM

    if inventory.path == SYSTEM:
        return
    for host in inventory.hosts.values():
        for file in (*([host.devices] if host.devices else []), *host.files):
            if not file.is_file():
                text = f"{inventory.path} names {file} for {host.name}, which does not exist"
                print(escape_line(f"lfield: {text}"), file=sys.stderr)


def find_own_keys(args: argparse.Namespace) -> Keys | None:
    """The keys of the user, None without any. Raises KeysError."""
    from lfield.authority import keystore

    folder = keystore.find_keys("person", keystore.OWN, args.keys, os.environ)
    return None if folder is None else keystore.read_keys(folder, "person")


def open_desk(args: argparse.Namespace) -> FleetDesk:
    """The desk of a command. Raises UsageError without an inventory, KeysError without keys."""
    from lfield.operator.client import presented_crl

    inventory = open_inventory(args)
    report_missing_files(inventory)
    keys = find_own_keys(args)
    if keys is None:
        raise KeysError(
            "there are no keys of yours here: 'lfield keys init --person NAME' makes them, and --keys names "
            "their directory"
        )
    return FleetDesk(inventory, keys, presented_crl(keys))


@contextmanager
def explained_interrupt(text: str) -> Iterator[None]:
    """After Ctrl-C print what the robots go on with."""
    try:
        yield
    except KeyboardInterrupt:
        print(f"interrupted: {text}; 'lfield status' shows it", file=sys.stderr)
        raise


def failure_status(errors: Mapping[str, LfieldError]) -> int:
    """The exit status for hosts that have not carried out a request: 69 if one was not reached.

    Else 1 if one has refused it: the same request would be refused again. 0 without errors.
    """
    if not errors:
        return exit_status.DONE
    is_refused = all(map(_is_refusal, errors.values()))
    return exit_status.FAILED if is_refused else exit_status.UNAVAILABLE


def _is_refusal(error: LfieldError) -> bool:
    """Whether the host was reached, and has refused the peer or its request."""
    return isinstance(error, HandshakeError) and not error.answered_by


def report_unreached(errors: Mapping[str, LfieldError], consequence: str) -> None:
    """A line on stderr for each host that did not answer, or has refused the request."""
    for host, error in errors.items():
        what = "REFUSED" if _is_refusal(error) else "NOT REACHED"
        print(escape_line(f"{host}: {what}{consequence}: {error}"), file=sys.stderr)


def split_answers(answers: Mapping[str, S | LfieldError]) -> tuple[dict[str, S], dict[str, LfieldError]]:
    """The answers, and the errors of the hosts that did not answer."""
    reached = {host: answer for host, answer in answers.items() if not isinstance(answer, LfieldError)}
    failed = {host: answer for host, answer in answers.items() if isinstance(answer, LfieldError)}
    return reached, failed
