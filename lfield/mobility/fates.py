"""What became of every coordinator: ended, alive somewhere, or lost with a host that is gone.

Every host keeps, for each coordinator it has seen, the number of the last transfer it knows of. Numbers only
grow along a coordinator's way, so the record with the highest one says where it went last. When that is a
host that is gone, or one that was restarted and knows nothing of it, nobody can go on from there: the
coordinator is lost.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from lfield.wire.messages import Known

_ALIVE = ("RUN", "FROZEN", "PREPARED")


@dataclass(frozen=True, slots=True)
class Fate:
    """A coordinator's end: `outcome` is done, died or lost; `detail` one line."""

    agent: str
    outcome: str
    detail: str


Records = Sequence[Known]


def fates(homes: Mapping[str, str], records: Mapping[str, Records], gone: Collection[str]) -> dict[str, Fate]:
    """The coordinators that have ended or are lost.

    `homes` has the host where each coordinator starts, `records`, for each host that answered, what it knows
    of coordinators; `gone` are the hosts given up. Hosts do not answer at the same moment: only a loss that
    two censuses in a row find is one.
    """
    found = {}
    for agent, home in homes.items():
        by_host = {
            host: [r for r in rows if r.agent == agent and r.outcome != "superseded"]
            for host, rows in records.items()
        }
        fate = _fate(agent, home, by_host, gone)
        if fate:
            found[agent] = fate
    return found


def _fate(agent: str, home: str, records: Mapping[str, Records], gone: Collection[str]) -> Fate | None:
    counted = [r for rows in records.values() for r in rows]
    ended = next((r for r in counted if r.state == "EXITED"), None)
    if ended:
        return Fate(agent, ended.outcome, ended.detail)
    if not counted:
        return Fate(agent, "lost", f"its host {home} is gone") if home in gone else None
    last = max(counted, key=lambda r: (r.generation, r.sequence, r.state in _ALIVE))
    if last.state in _ALIVE:
        return None
    where, number = last.where, (last.generation, last.sequence)
    if where in gone:
        return Fate(agent, "lost", f"it went to {where} (transfer {last.sequence}), which is gone")
    there = records.get(where)
    if there is None or any((r.generation, r.sequence) >= number for r in there):
        return None
    return Fate(agent, "lost", f"it went to {where} (transfer {last.sequence}), which was restarted")
