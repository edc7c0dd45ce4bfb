"""A stop goes out, whatever the words of its reason are, and wherever the mission lies."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Bell {
    init(string[] arg) { }
    portal ring() { write("läutet\\n"); }
}
coordinator Ringer {
    init(string[] arg) { findBell(arg[1]).ring(); sleep(1000.0); }
}
"""
DEPLOYMENT = "//Bell:bell@alpha\n//Ringer:tom@alpha?bell\n"
#: A terminal whose encoding has no more than ASCII.
ASCII = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}


def test_bytes_that_are_no_text_keep_nothing_from_a_running_mission(lfield, own):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT, name="n\udcf6rd/mission")
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", env=own)
    team.wait_for("läutet")
    pressed = lfield("estop", "--no-wait", "--reason", "gr\udcf6\udcdfe", env=own)
    assert lfield.status(pressed) == 0, pressed.said
    team.wait_for(r"EMERGENCY STOP by .*: the emergency stop was pressed: gr\\u\{dcf6\}\\u\{dcdf\}e")
    for words in (["estop", "--lift", "--reason", "\udcff"], ["pause"], ["resume"], ["ps"]):
        told = lfield(*words, env=own)
        assert lfield.status(told) == 0, told.said
    for words in (["logs"], ["events", "--no-follow"]):
        told = lfield(*words, env=own | ASCII)
        assert lfield.status(told) == 0, told.said
        assert r"l\u{e4}utet" in told.said
    for words in (
        ["forget", "\udcff"],
        ["recover", "\udcff"],
        ["events", "--host", "\udcff"],
        ["ps", "--run", "\udcff"],
    ):
        told = lfield(*words, env=own)
        assert lfield.status(told) == 64, told.said
        assert r"\u{dcff}" in told.said
