"""What a program commands begins in time or not at all, whatever stood still meanwhile. In virtual time."""

from __future__ import annotations

import random
import re
from dataclasses import replace

import pytest

from lfield.guard.core import SILENCE
from lfield.mission.load import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.fleet import Fleet
from lfield.simulate.hardware import ANSWER
from lfield.simulate.weather import Weather

PROGRAM = """
resource Post {
    Mavlink fc;
    int count = 0;
    init(string[] arg) { }
    portal visit() {
        count = count + 1;
        print("climb " + count);
        fc.takeoff(1.0 * count);
    }
    portal release() { fc.release(); }
}
coordinator Walker {
    init(string[] arg) {
        Post post = find("p");
        while (true) {
            try { post.release(); post.visit(); } catch (Exception refused) { print("refused: " + refused.message()); }
            sleep(0.1);
        }
    }
}
"""
#: The default time-to-live: longer than a host may be silent, so it is how long a command may take to begin.
TTL = 0.5


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Mission:
    folder = tmp_path_factory.mktemp("mission")
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text("//Post:p@alpha\n//Walker:walker@alpha\n")
    mission = load_mission(folder / "mission.dL", simulate=True)
    return replace(mission, bindings=replace(mission.bindings, silence=SILENCE))
