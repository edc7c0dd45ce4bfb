"""The output of `lfield status` for a team."""

from __future__ import annotations

import time

from msgspec.structs import replace

from lfield.cli.fleet.status_view import differing_versions, status_lines
from lfield.wire.service_messages import BundleInfo, RunInfo, ServiceStatus


def status(host: str, version: str) -> ServiceStatus:
    return ServiceStatus(host, version, b"", b"", [], RunInfo(), None, [], "", time.time())


def test_different_versions_of_lfield_are_named() -> None:
    same = {host: status(host, "0.4.0") for host in ("alpha", "bravo")}
    assert differing_versions(same) == ""
    assert list(status_lines(same)) == []
    mixed = same | {"carol": status("carol", "0.4.1")}
    assert "carol: 0.4.1" in differing_versions(mixed)
    assert differing_versions(mixed) in list(status_lines(mixed))


def test_a_coordinator_of_an_unreached_host_is_not_reported_idle() -> None:
    digest = bytes(32)[:-1] + b"1"
    info = BundleInfo(digest, "patrol", hosts=["alpha", "bravo"], coordinators={"pilot": "bravo"})
    up = replace(status("alpha", "0.4.0"), active=digest, bundles=[info], run=RunInfo(digest, "running"))
    assert list(status_lines({"alpha": up})) == []
    down = replace(up, host="bravo", run=RunInfo(digest, "stopped"))
    assert any("pilot" in line for line in status_lines({"alpha": up, "bravo": down}))
