"""What can be wrong with a test of a mission."""

from __future__ import annotations

from lfield import exits
from lfield.errors import LfieldError


class MissionTestError(LfieldError):
    """A test of a mission asks for what there is not, or does what a test may not."""

    exit_status = exits.USAGE


class Stuck(MissionTestError):
    """What a test waits for does not come: `standing` says where every agent stands and what it waits for."""

    def __init__(self, waited: str, standing: list[str]) -> None:
        self.standing = standing
        super().__init__("\n".join([waited, *(f"  {line}" for line in standing)]))


class RealEndpoint(MissionTestError):
    """Something under test wanted to use this computer's network, ports or devices."""

    def __init__(self, what: str) -> None:
        self.what = what
        super().__init__(
            f"a test of a mission touches nothing real, and {what}: give the device a fake or double its agent"
        )
