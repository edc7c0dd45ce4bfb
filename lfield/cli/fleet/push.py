"""`lfield push`: sends a bundle to all robots of its mission, and activates it on all or none."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.fleet.desk import (
    VOTE_GOES_ON,
    add_desk,
    add_without,
    explained_interrupt,
    failure_status,
    open_desk,
    report_unreached,
)
from lfield.cli.mission_argument import add_bindings, add_program
from lfield.client.service_desk import FleetDesk, ask_all_services, split_answers
from lfield.errors import BundleError, LfieldError, UsageError
from lfield.text.number_arguments import real_above_0
from lfield.text.suggestions import listed
from lfield.text.value_text import byte_count_text
from lfield.wire.fields import short_digest

if TYPE_CHECKING:
    from lfield.cli.fleet.ballot_report import PushReport
    from lfield.operator.fleet.bundle_upload import Upload, UploadProgress
    from lfield.operator.fleet.service_link import ServiceLinks
    from lfield.wire.service_messages import ServiceStatus

#: Default of --patience (s), seconds in which a host must answer first, and in which its service must listen.
PATIENCE, FIRST_CONTACT, FIRST_LISTENER = 60.0, 15.0, 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "mission", metavar="MISSION", type=Path, help="bundle (.lfm), or deployment (.dL) to build and sign"
    )
    add_program(parser)
    add_bindings(parser)
    add_without(parser, "activate without this host, which cannot join until it has the bundle")
    parser.add_argument(
        "--stage", action="store_true", help="send the bundle and do not activate it; a later push does"
    )
    parser.add_argument(
        "--patience",
        metavar="SECONDS",
        type=real_above_0(1e6, "seconds"),
        default=PATIENCE,
        help="seconds after which a host that has confirmed nothing counts as failed (default: 60)",
    )
    add_desk(parser)


def run(args: argparse.Namespace) -> int:
    """Returns 0 when the bundle is active on all hosts; 1 when one refuses, 69 when one was not reached.

    Returns 4 when the result of the vote is not known yet.
    """
    from lfield.cli.fleet.ballot_report import PushReport
    from lfield.mission import bundle
    from lfield.mission.build_cache import BuildFailed
    from lfield.operator.fleet.bundle_upload import Upload

    desk = open_desk(args)
    try:
        data = _bundle_bytes(args, desk)
    except BuildFailed as error:
        return error.status
    mission = bundle.decode(data)
    team = mission.team.hosts
    _check_hosts(args.without, team)
    desk.addresses(team)
    source = Upload.of(data)
    report = PushReport(source.digest, as_json=args.json)
    report.start(f"{mission.name}: bundle {short_digest(source.digest)}, {byte_count_text(source.size)}")
    hosts = [host for host in team if host not in args.without]
    with explained_interrupt(VOTE_GOES_ON):
        return asyncio.run(_push(desk, source, hosts, args, report))


async def _push(
    desk: FleetDesk, source: Upload, hosts: list[str], args: argparse.Namespace, report: PushReport
) -> int:
    """Send the bundle, then have the hosts vote, over one link to each."""
    links = desk.links(hosts)
    try:
        # A host that is off is named, and not waited for.
        statuses, silent = split_answers(await service_states(links))
        sent, failed = split_answers(await _upload_all(links, source, list(statuses), args.patience, report))
        failed |= silent
        report.on_sent(sent, source.size)
        refused = [host for host, progress in sent.items() if progress.refusal]
        if failed or refused:
            report_unreached(failed, "")
            out = [*failed, *refused]
            hint = "".join(f" --without {host}" for host in out)
            # Without all hosts there is no mission.
            alternative = f", or activate without them:{hint}" if len(out) < len(hosts) else ""
            consequence = f"this push has activated nothing; repeat it{alternative}"
            report.finish("staged", failed, consequence)
            return failure_status(failed) if failed else exit_status.FAILED
        if args.stage:
            report.finish("staged", {}, f"stored on {listed(hosts)}, not active")
            return exit_status.DONE
        return await vote(desk, links, source.digest, statuses, report)
    finally:
        links.close()


async def service_states(
    links: ServiceLinks, hosts: list[str] | None = None, *, is_known: bool = False
) -> dict[str, ServiceStatus | LfieldError]:
    """The states of services. A service known to run may be restarting: its request is repeated for some
    time.

    In a Zenoh fabric the service may also have lost its router.
    """
    from lfield.net.transport import has_zenoh
    from lfield.operator.fleet.service_link import RESTART_TIME
    from lfield.wire.service_messages import ServiceQuery, ServiceStatus

    is_waited_for = is_known or any(map(has_zenoh, links.addresses.values()))
    restart = RESTART_TIME if is_waited_for else FIRST_LISTENER
    return await ask_all_services(links, ServiceQuery(), ServiceStatus, FIRST_CONTACT, hosts, restart=restart)


async def vote(
    desk: FleetDesk,
    links: ServiceLinks,
    digest: bytes,
    statuses: Mapping[str, ServiceStatus],
    report: PushReport,
) -> int:
    """Have hosts vote about the activation of a bundle that all have stored; returns the exit status.

    `statuses` are those of a moment ago.
    """
    from lfield.operator.fleet.activation import activate, new_ballot

    hosts = list(statuses)
    if all(status.active == digest for status in statuses.values()):
        report.finish("activated", {}, f"already active on {listed(hosts)}")
        return exit_status.DONE
    # A vote holds the missions of all hosts: not for one that a host would refuse.
    now, silent = split_answers(await service_states(links, hosts, is_known=True))
    reasons = {host: state.refusal for host, state in now.items() if state.refusal and state.active != digest}
    if silent or reasons:
        report_unreached(silent, "")
        return report.on_refusals(reasons, silent)
    return report.on_result(await activate(links, new_ballot(digest, hosts, desk.user)))


async def _upload_all(
    links: ServiceLinks, source: Upload, hosts: list[str], patience: float, report: PushReport
) -> dict[str, UploadProgress | LfieldError]:
    from lfield.operator.fleet.bundle_upload import upload

    async def upload_to(host: str) -> UploadProgress | LfieldError:
        def on_progress(progress: UploadProgress) -> None:
            report.on_progress(host, progress)

        try:
            return await upload(links, host, source, patience=patience, on_progress=on_progress)
        except LfieldError as error:
            return error

    return dict(zip(hosts, await asyncio.gather(*map(upload_to, hosts)), strict=True))


def _bundle_bytes(args: argparse.Namespace, desk: FleetDesk) -> bytes:
    """The signed bundle of the arguments: read, or built and signed. Raises BuildFailed."""
    from lfield.mission import bundle
    from lfield.mission.build_cache import BuildRequest, cached_bundle

    path: Path = args.mission
    if path.suffix != bundle.SUFFIX:
        if path.suffix in (".L", ".lb"):
            raise UsageError(f"{path} is a program: name its deployment, {path.with_suffix('.dL')}")
        request = BuildRequest(path, args.program, args.devices, as_json=args.json)
        with cached_bundle(request) as file:
            return _signed(bundle.read_file(file), desk)
    if args.program is not None or args.devices is not None:
        raise UsageError(f"{path} is a bundle, which has its program and devices: leave these options out")
    data = bundle.read_file(path)
    try:
        found = bundle.contents(data)
    except BundleError as error:
        raise error.of(path) from None
    return data if found.signature else _signed(data, desk)


def _signed(data: bytes, desk: FleetDesk) -> bytes:
    """The bundle with a signature by the user of this desk. Raises KeysError."""
    import time

    from lfield.authority.bundle_signature import sign_bundle
    from lfield.mission import bundle

    signature = sign_bundle(bundle.contents(data).digest, desk.keys, time.time())
    return bundle.with_signature(data, signature)


def _check_hosts(without: list[str], hosts: tuple[str, ...]) -> None:
    for host in without:
        if host not in hosts:
            raise UsageError(f"--without {host}: the mission has no host '{host}': it has {listed(hosts)}")
    if set(without) == set(hosts):
        raise UsageError("no host is left: --without names all of them")
