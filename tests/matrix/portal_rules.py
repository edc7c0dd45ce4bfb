"""A mission whose access file says which coordinators may call which portals."""

from __future__ import annotations

from pathlib import Path

from lfield.mission.load import load_mission

FILES = {
    ".L": """
resource Arm {
    init(string[] arg) { }
    portal home() { }
    portal grab(real width) { }
}
resource Winch { init(string[] arg) { } portal up() { } portal unreel() { } }
coordinator Loader { init(string[] arg) { findArm("arm1").home(); } }
coordinator Watch { init(string[] arg) { findArm("arm2").home(); } }
coordinator Guest { init(string[] arg) { findWinch("winch").up(); } }
""",
    ".dL": """//Arm:arm1@alpha
//Arm:arm2@bravo
//Winch:winch@bravo
//Loader:loader@alpha
//Watch:day@alpha
//Watch:night@bravo
//Guest:guest@bravo
""",
    ".access.yaml": """coordinators:
  loader:
    Arm: [home]
    arm1: all
  Watch:
    others: [home, up]
    winch: []
  night: {}
  others: all
""",
}


class Portals:
    """The rules of that mission, and those of the same mission without."""

    def __init__(self, folder: Path) -> None:
        for ending, text in FILES.items():
            (folder / f"mission{ending}").write_text(text)
        self.mission = load_mission(folder / "mission.dL")

    def tried(self, who: str, what: str) -> bool:
        """Whether a coordinator may call a portal: `arm1.home`."""
        members = {member.id: member for member in self.mission.team.members}
        resource, _, portal = what.partition(".")
        return not self.mission.access.refusal(members[who], members[resource], portal)
