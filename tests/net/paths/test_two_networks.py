"""Two hosts with two networks between them: a coordinator continues to hop while one of the networks fails.

tests/net/paths/test_path_change.py has the cases that need no namespaces.
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Iterator

import pytest
from namespaces import namespaces  # noqa: F401
from two_networks import HOSTS, NETWORKS, TwoNetworks

pytestmark = pytest.mark.process

#: Hops after a failure until which hops must have resumed.
STAMPS = 60


@pytest.fixture
def net(request, tmp_path) -> Iterator[TwoNetworks]:
    if not request.getfixturevalue("namespaces") or shutil.which("nft") is None:
        pytest.skip(
            "no network namespaces or no nft here: test_path_change.py has the variants in virtual time"
        )
    made = TwoNetworks(tmp_path)
    try:
        yield made
    finally:
        made.close()


@pytest.mark.few(0)
def test_hops_continue_over_the_other_network_and_are_executed_once(net):
    for host in HOSTS:
        net.start(host)
    path, since = 0, 0.0
    failures = [(kind, host) for kind in (net.down, net.drop) for host in HOSTS]
    for kind, host in failures:
        for each in net.hosts.values():
            each.wait_for("standby connection with", since)
        count, failed = len(net.stamps()), time.monotonic()
        kind(host, NETWORKS[path])
        net.wait_for_stamps(count + STAMPS)
        gap = net.gap(failed, net.stamps()[count + STAMPS - 1][0])
        print(f"{kind.__name__} {NETWORKS[path]} at {host}: no hop for {gap:.2f} s")
        since = time.monotonic()
        net.up(host, NETWORKS[path]) if kind == net.down else net.drop_none(host)
        path = 1 - path
    # The standby connection continued each link; test_path_change.py checks the times, in virtual time.
    assert re.search(r"link to \w+ lost", net.text()) is None
    for host in HOSTS:
        net.hosts[host].end()
    numbers = [number for _, number in net.stamps()]
    assert sorted(numbers) == list(range(len(numbers)))
    assert sum(each.text().count(" moves from ") for each in net.hosts.values()) >= len(failures)
