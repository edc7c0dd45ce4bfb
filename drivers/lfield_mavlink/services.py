"""What the services of a vehicle share: its plans and its files."""

from __future__ import annotations

from functools import cached_property

from lfield_mavlink.file_transfer import FileTransfer
from lfield_mavlink.plan_transfer import PlanTransfer
from lfield_mavlink.streams import Streams
from lfield_mavlink.tuning import Tuning


class Services(Tuning, Streams):
    """Protocols beside flight: none of them moves the vehicle."""

    def _set_up(self) -> None:
        super()._set_up()
        self._files = FileTransfer(self._peer)

    @cached_property
    def _plans(self) -> PlanTransfer:
        """Made at its first use: only then is it known which autopilot this is."""
        return PlanTransfer(self._peer, home_first=not self.profile.px4)
