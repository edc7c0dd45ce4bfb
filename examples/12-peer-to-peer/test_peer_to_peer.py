"""Peer to peer, on virtual time: `lfield test examples/12-peer-to-peer`."""

from __future__ import annotations

import re

ASKED = [
    ("ann", "bob", "0"), ("ann", "cyd", "1"),
    ("bob", "ann", "1"), ("bob", "cyd", "0"), ("bob", "cyd", "2"),
    ("cyd", "ann", "0"), ("cyd", "bob", "1"),
]  # fmt: skip


def test_every_question_gets_its_answer(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    lines = [line.text for line in team.log]
    asked = re.findall(r"^(\w+) asks (\w+) about target (\d)$", "\n".join(lines), re.M)
    assert sorted(asked) == ASKED
    for who, whom, target in asked:
        confirmed = (int(target) + 3) % 2 == 0
        verdict = "keeps" if confirmed else "drops"
        assert f"{whom} judges target {target} of {who}: {str(confirmed).lower()}" in lines
        assert f"{who} {verdict} target {target}" in lines


def test_disconnected_peer_is_asked_after_its_return(lfield_mission):
    team = lfield_mission("mission.dL")
    team.at(0.09, lambda: [team.cut("hill", other) for other in ("west", "east")])
    team.at(3.0, lambda: [team.heal("hill", other) for other in ("west", "east")])
    team.run(until_done=True)
    assert team.now > 3.0
    said = "\n".join(line.text for line in team.log)
    assert sorted(re.findall(r"^(\w+) asks (\w+) about target (\d)$", said, re.M)) == ASKED
