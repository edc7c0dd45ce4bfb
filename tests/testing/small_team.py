"""A small simulated team with recorded portal calls and optional doubles."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, HostRun
from lfield.testing.mission.call_record import CallRecorder, RecordedCall
from lfield.testing.mission.resource_doubles import ResourceDoubles


class SmallTeam(Fleet):
    """A program and a deployment, or those in the folder, on simulated computers.

    The first exception of a double is raised.
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
        self.doubles = ResourceDoubles(mission, doubles or {})
        self.calls = CallRecorder(lambda: self.now)
        super().__init__(mission, 1, watch=SmallTeam._look, on_start=self._watched)

    def _watched(self, name: str, life: HostRun) -> None:
        self.calls.observe(life.core.machine)
        self.doubles.attach(life)

    def _look(self) -> None:  # type: ignore[override]
        self.doubles.release_monitors()
        if self.doubles.failures:
            raise self.doubles.failures.pop(0)

    def said(self, text: str) -> bool:
        return any(text in line for _, _, line in self.log)

    def until(self, text: str) -> None:
        """Advance time until a log line contains the text."""
        end = self.now + 60.0
        while not self.said(text):
            assert self.now < end, f"no line with {text!r}: {self.log}"
            self.run(0.05)

    def call(self, portal: str) -> RecordedCall:
        """The only call of a portal."""
        (found,) = (call for call in self.calls.record if call.portal == portal)
        return found

    def call_results(self, portal: str) -> list[object]:
        """The results of the calls of a portal, in the order of their start."""
        return [call.result for call in self.calls.record if call.portal == portal]
