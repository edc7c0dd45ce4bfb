"""`lfield push`: sends a bundle to all robots of its mission, and activates it on all or none."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.fleet.desk import FleetDesk, add_desk, add_without, open_desk, report_unreached, split_answers
from lfield.cli.mission_argument import add_bindings, add_program
from lfield.errors import BundleError, LfieldError, UsageError
from lfield.text.number_arguments import real_above_0
from lfield.text.suggestions import listed
from lfield.text.value_text import byte_count_text
from lfield.wire.fields import short_digest

if TYPE_CHECKING:
    from lfield.cli.fleet.ballot_report import PushReport
    from lfield.operator.fleet.activation import BallotResult
    from lfield.operator.fleet.bundle_upload import Upload, UploadProgress

#: Default of --patience (s).
PATIENCE = 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
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
        help="give up on a host that confirms nothing for this long (default: 60)",
    )
    add_desk(parser)


def run(args: argparse.Namespace) -> int:
    """0 when the bundle is active on all hosts; 1 when one refuses it, 69 when one was not reached.

    4 when the result of the vote is not known yet.
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
    what = Upload.of(data)
    report = PushReport(what.digest, as_json=args.json)
    report.start(f"{mission.name}: bundle {short_digest(what.digest)}, {byte_count_text(what.size)}")
    return _push(desk, what, [host for host in team if host not in args.without], args, report)


def _push(
    desk: FleetDesk, what: Upload, hosts: list[str], args: argparse.Namespace, report: PushReport
) -> int:
    """Send the bundle, then vote."""
    # A host that is off is not waited for, but named.
    _, silent = split_answers(desk.statuses(hosts))
    reached = [host for host in hosts if host not in silent]
    sending = _upload_all(desk, what, reached, args.patience, report.on_progress)
    sent, failed = split_answers(asyncio.run(sending))
    failed |= silent
    report.on_sent(sent, what.size)
    refused = [host for host, progress in sent.items() if progress.refusal]
    if failed or refused:
        report_unreached(failed, "")
        hint = "".join(f" --without {host}" for host in (*failed, *refused))
        report.finish("staged", failed, f"nothing was activated; repeat it, or activate without them:{hint}")
        return exit_status.FAILED if refused else exit_status.UNAVAILABLE
    if args.stage:
        report.finish("staged", {}, f"stored on {listed(hosts)}, not active")
        return exit_status.DONE
    return vote(desk, what.digest, hosts, args.without, report)


def vote(desk: FleetDesk, digest: bytes, hosts: list[str], without: list[str], report: PushReport) -> int:
    """Have hosts vote about the activation of a bundle that all have stored; returns the exit status."""
    from lfield.operator.fleet.activation import activate, new_ballot

    statuses, failed = split_answers(desk.statuses(hosts))
    if failed:
        report_unreached(failed, "")
        report.finish("staged", failed, "nothing was activated: not all hosts answered before the vote")
        return exit_status.UNAVAILABLE
    if all(status.active == digest for status in statuses.values()):
        report.finish("activated", {}, f"already active on {listed(hosts)}")
        return exit_status.DONE
    ballot = new_ballot(digest, hosts, without, desk.user)

    async def ask() -> BallotResult:
        return await activate(desk.transport(), desk.addresses(hosts), ballot, desk.crl)

    return report.on_result(asyncio.run(ask()))


async def _upload_all(
    desk: FleetDesk,
    what: Upload,
    hosts: list[str],
    patience: float,
    on_progress: Callable[[str, UploadProgress], None],
) -> dict[str, UploadProgress | LfieldError]:
    from lfield.operator.fleet.bundle_upload import upload

    transport, addresses = desk.transport(), desk.addresses(hosts)

    async def one(host: str) -> UploadProgress | LfieldError:
        try:
            return await upload(
                transport,
                addresses[host],
                host,
                what,
                patience=patience,
                crl=desk.crl,
                on_progress=lambda progress: on_progress(host, progress),
            )
        except LfieldError as error:
            return error

    return dict(zip(hosts, await asyncio.gather(*map(one, hosts)), strict=True))


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
