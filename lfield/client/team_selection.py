"""The team of a command or program: of a mission, of a run on this computer, or of the inventory."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct

from lfield.errors import NoMissionRunning, UsageError

if TYPE_CHECKING:
    from lfield.operator.runs import Run
    from lfield.operator.targets import TargetTeam


class TeamSelection(Struct, frozen=True):
    """A selection of hosts.

    `mission` is a deployment or bundle, None for the runs on this computer; `run` the id of a run on this
    computer, '' for any. `maps` are addresses `NAME=ADDR:PORT`. `inventory` and `keys` replace the default
    file and the default folder.
    """

    mission: Path | None = None
    run: str = ""
    maps: Sequence[str] = ()
    inventory: Path | None = None
    keys: Path | None = None

    def inventory_addresses(self) -> Mapping[str, str]:
        """The addresses of the hosts of the inventory, by name. Raises ProgramError, InputFileError."""
        from lfield.inventory.location import find_inventory

        inventory = find_inventory(self.inventory, os.environ)
        return {} if inventory is None else {name: host.address for name, host in inventory.hosts.items()}

    def runs(self) -> list[Run]:
        """The runs that this user may see, or the named one. Raises UsageError, NoMissionRunning."""
        from lfield.operator.runs import no_runs_hint, runs_here
        from lfield.operator.targets import select_runs

        runs = select_runs(runs_here(), self.run)
        if self.mission is not None:
            return runs
        if self.maps:
            raise UsageError("--map is for the hosts of a mission: name the mission too")
        if not runs and not self.inventory_addresses():
            raise NoMissionRunning(f"no mission is running on this computer: {no_runs_hint()}")
        return runs

    def teams(self, runs: list[Run]) -> list[TargetTeam]:
        """The hosts of the named mission, or of all these runs. Raises UsageError.

        Without a run of this user, and with a named inventory, the hosts of the inventory.
        """
        targets = self._teams(runs)
        self._configure_zenoh(targets)
        return targets

    def _configure_zenoh(self, targets: Sequence[TargetTeam]) -> None:
        """Use the routers of a named inventory for addresses in a fabric, else those of the run, else the
        default inventory's: the addresses may be those of a run."""
        from lfield.net.transport import has_zenoh
        from lfield.net.zenoh.config import NETWORK

        addresses = [address for target in targets for address in target.addresses.values()]
        if NETWORK.config is not None or not any(map(has_zenoh, addresses)):
            return
        known = [run.manifest.zenoh for target in targets for run in target.runs if not run.user]
        config = next((each for each in known if each is not None), None)
        if config is None or self.inventory is not None:
            self.inventory_addresses()
        else:
            NETWORK.configure(config)

    def _teams(self, runs: list[Run]) -> list[TargetTeam]:
        from lfield.operator.targets import TargetTeam, open_team, targets_of_runs, targets_of_team

        if self.mission is None:
            targets = targets_of_runs(runs)
            if not self.run and (self.inventory or all(run.user for run in runs)):
                addresses = self.inventory_addresses()
                targets = [TargetTeam((), addresses), *targets] if addresses else targets
            return targets
        team = open_team(self.mission)
        if self.run and runs[0].manifest.deployment != team.deployment.hex():
            raise UsageError(f"{runs[0].id} is not a run of {self.mission}")
        return targets_of_team(team, runs, self.maps, self.inventory_addresses)

    def single(self) -> tuple[TargetTeam, list[str]]:
        """The one named or running team, and the runs of other users that were left out.

        Raises UsageError, NoMissionRunning.
        """
        from lfield.operator.targets import single_target

        targets = self.teams(self.runs())
        target = single_target(targets)
        return target, [other.id for other in targets if other.user and other is not target]
