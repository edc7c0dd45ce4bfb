"""A small simulated team whose portal calls are recorded, and of which some have doubles."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lfield.mission.load import load_mission
from lfield.simulate.fleet import Fleet, Life
from lfield.testing.mission.calls import Calls, PortalCall
from lfield.testing.mission.doubles import Doubles


class SmallTeam(Fleet):
    """A program and a deployment, or those in the folder, on simulated computers.

    The first trouble of a double is raised.
    """

    def __init__(
        self,
        folder: Path,
        program: str = "",
        deployment: str = "",
        doubles: Mapping[str, object] | None = None,
    ) -> None:
        if program:
            (folder / "mission.L").write_text(program)
            (folder / "mission.dL").write_text("\n".join([*deployment.split(), ""]))
        mission = load_mission(folder / "mission.dL", simulate=True, doubled=doubles or {})
        self.doubles = Doubles(mission, doubles or {})
        self.calls = Calls(lambda: self.now)
        super().__init__(mission, 1, watch=SmallTeam._look, born=self._watched)

    def _watched(self, name: str, life: Life) -> None:
        self.calls.watch(life.core.machine)
        self.doubles.watch(life)

    def _look(self) -> None:  # type: ignore[override]
        self.doubles.take_turns()
        if self.doubles.trouble:
            raise self.doubles.trouble.pop(0)

    def said(self, text: str) -> bool:
        return any(text in line for _, _, line in self.log)

    def until(self, text: str) -> None:
        """Let time go on until it is said."""
        end = self.now + 60.0
        while not self.said(text):
            assert self.now < end, f"nobody has said {text!r}: {self.log}"
            self.run(0.05)

    def call(self, portal: str) -> PortalCall:
        """The only call of a portal."""
        (found,) = (call for call in self.calls.record if call.portal == portal)
        return found

    def call_results(self, portal: str) -> list[object]:
        """What the calls of a portal have given, in the order of their beginning."""
        return [call.result for call in self.calls.record if call.portal == portal]
