"""Peer to peer, on virtual time: `lfield test examples/12-peer-to-peer`."""

from __future__ import annotations

import re

#: Each request: the sender, the receiver and the target.
REQUESTS = [
    ("ann", "bob", "0"), ("ann", "cyd", "1"),
    ("bob", "ann", "1"), ("bob", "cyd", "0"), ("bob", "cyd", "2"),
    ("cyd", "ann", "0"), ("cyd", "bob", "1"),
]  # fmt: skip


def test_each_request_gets_a_verdict(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    lines = [line.text for line in team.log]
    requests = re.findall(r"^(\w+) asks (\w+) about target (\d)$", "\n".join(lines), re.M)
    assert sorted(requests) == REQUESTS
    for sender, receiver, target in requests:
        confirmed = (int(target) + 3) % 2 == 0
        verdict = "keeps" if confirmed else "drops"
        assert f"{receiver} judges target {target} of {sender}: {str(confirmed).lower()}" in lines
        assert f"{sender} {verdict} target {target}" in lines


def test_requests_to_a_disconnected_peer_wait_for_its_reconnection(lfield_mission):
    team = lfield_mission("mission.dL")
    team.at(0.09, lambda: [team.cut("hill", other) for other in ("west", "east")])
    team.at(3.0, lambda: [team.heal("hill", other) for other in ("west", "east")])
    team.run(until_done=True)
    assert team.now > 3.0
    lines = "\n".join(line.text for line in team.log)
    assert sorted(re.findall(r"^(\w+) asks (\w+) about target (\d)$", lines, re.M)) == REQUESTS
