"""The sentences of `lfield status` about a team."""

from __future__ import annotations

import time

from lfield.cli.fleet.status_view import differing_versions, status_lines
from lfield.wire.service_messages import RunInfo, ServiceStatus


def status(host: str, version: str) -> ServiceStatus:
    return ServiceStatus(host, version, b"", b"", [], RunInfo(), None, [], "", time.time())


def test_different_versions_of_lfield_are_named() -> None:
    same = {host: status(host, "0.4.0") for host in ("alpha", "bravo")}
    assert differing_versions(same) == ""
    assert list(status_lines(same)) == []
    mixed = same | {"carol": status("carol", "0.4.1")}
    assert "carol: 0.4.1" in differing_versions(mixed)
    assert differing_versions(mixed) in list(status_lines(mixed))
