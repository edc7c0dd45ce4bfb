"""Appendix I: the coordinator has visited six hosts and is lost on the seventh (figures I.3 and I.4).

Whole hosts, virtual time. Each of the six hosts holds a shadow; the fifth, s5, has the newest one.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal stamp(int n) { print("stamp " + i2s(n)); }
    portal hold() { print("holding"); sleep(60.0); }
}
coordinator Walker {
    init(string[] arg) {
        heartbeatInterval(3.0);
        Post[] posts = findPost();
        for (int n = 0; n < 6; n += 1) posts[n].stamp(n);
        try { posts[6].hold(); }
        catch (RestartException e) { print("restarted at the call of " + e.source()); }
        for (int n = 0; n < 7; n += 1) {
            try { posts[n].stamp(10 + n); }
            catch (UnreachableResourceException e) { print("without " + e.source()); }
        }
        print("complete");
    }
}
"""
HOSTS = ("s0", "s1", "s2", "s3", "s4", "s5", "c")


def lines(fleet: Fleet, start: str) -> list[str]:
    """The log lines of the walker and the posts from `start` on."""
    return [text.strip().partition(": ")[2] for _, _, text in fleet.log if f": {start}" in text]


def run_until(fleet: Fleet, text: str, seconds: float) -> None:
    """Run until a line has this text; fail after `within` seconds."""
    end = fleet.now + seconds
    while not any(text in line for _, _, line in fleet.log):
        assert fleet.now < end, "".join(line for _, _, line in fleet.log[-20:])
        fleet.run(0.1)


def walk(folder: Path, lost: tuple[str, ...]) -> Fleet:
    """A fleet in which the hosts `lost` are switched off while the coordinator waits on c."""
    posts = "".join(f"//Post:p{n}@{host}\n" for n, host in enumerate(HOSTS))
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text(posts + "//Walker:walker@s0\n")
    fleet = Fleet(load_mission(folder / "mission.dL", simulate=True), 1)
    run_until(fleet, "holding", 30.0)
    for host in lost:
        fleet.power_off(host)
    run_until(fleet, "walker: complete", 60.0)
    return fleet


@pytest.mark.parametrize("lost", [("c",), ("c", "s2", "s4")], ids=["simple case", "complex case"])
def test_the_newest_shadow_continues_at_the_call_for_which_it_left(
    tmp_path: Path, lost: tuple[str, ...]
) -> None:
    fleet = walk(tmp_path, lost)
    where = {host for _, host, text in fleet.log if "walker: restarted at the call of p6" in text}
    assert where == {"s5"}
    assert lines(fleet, "stamp 1") == ["stamp 1"] + [
        f"stamp {10 + n}" for n, host in enumerate(HOSTS) if host not in lost
    ]
    assert lines(fleet, "without") == [f"without p{n}" for n, host in enumerate(HOSTS) if host in lost]
    assert lines(fleet, "complete") == ["complete"]
