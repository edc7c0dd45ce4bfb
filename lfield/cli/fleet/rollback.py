"""`lfield rollback`: activates the previous bundle on all robots or none."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.fleet.desk import add_desk, add_without, open_desk, report_unreached, split_answers
from lfield.errors import UsageError
from lfield.text.suggestions import listed
from lfield.wire.fields import short_digest

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lfield.wire.service_messages import ServiceStatus


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_without(parser, "leave out this host, which cannot join until it has the bundle")
    add_desk(parser)


def run(args: argparse.Namespace) -> int:
    """0 when the previous bundle is active on all hosts; else as `lfield push`."""
    from lfield.cli.fleet.ballot_report import PushReport
    from lfield.cli.fleet.push import vote

    desk = open_desk(args)
    desk.addresses(args.without)
    hosts = [host for host in desk.hosts if host not in args.without]
    statuses, failed = split_answers(desk.statuses(hosts))
    if failed:
        report_unreached(failed, "; nothing was changed")
        return exit_status.UNAVAILABLE
    digest = _common_previous(statuses)
    report = PushReport(digest, as_json=args.json)
    report.begin(f"bundle {short_digest(digest)}")
    return vote(desk, digest, hosts, args.without, report)


def _common_previous(statuses: Mapping[str, ServiceStatus]) -> bytes:
    """The previous bundle of all hosts. Raises UsageError where they differ."""
    found = {host: status.previous for host, status in statuses.items()}
    if len(set(found.values())) > 1:
        each = listed([f"{host}: {short_digest(digest) or 'none'}" for host, digest in found.items()])
        raise UsageError(f"the previous bundles differ ({each}): push the bundle that all should have")
    digest = next(iter(found.values()), b"")
    if not digest:
        raise UsageError("no host has had another bundle: there is nothing to go back to")
    return digest
