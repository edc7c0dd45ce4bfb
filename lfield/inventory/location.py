"""Finds the inventory of a command. The reader, and with it YAML, is imported only if there is one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.errors import NoHomeFolder
from lfield.net.zenoh.config import NETWORK
from lfield.text.user_dirs import config_dir

if TYPE_CHECKING:
    from lfield.inventory.inventory import Inventory

#: The variable that names the file, and the file of a robot.
VARIABLE, SYSTEM = "LFIELD_INVENTORY", Path("/etc/lfield/inventory.yaml")


def find_inventory(named: Path | None, environment: Mapping[str, str]) -> Inventory | None:
    """The inventory of a command: `named`, else $LFIELD_INVENTORY, else the user's, else that of the robot.

    None without any, and with an empty variable. Its section `zenoh` is that of this process from now on.
    Raises as `read_inventory`.
    """
    path = inventory_path(named, environment)
    if path is None:
        return None
    from lfield.inventory.inventory_file import read_inventory

    inventory = read_inventory(path)
    NETWORK.configure(inventory.zenoh, inventory.own_sections)
    return inventory


def inventory_path(named: Path | None, environment: Mapping[str, str]) -> Path | None:
    """The file of the inventory; None without any."""
    if named is None and environment.get(VARIABLE) == "":
        return None
    chosen = named or (Path(environment[VARIABLE]) if environment.get(VARIABLE) else None)
    if chosen is not None:
        return chosen
    try:
        own = config_dir() / "inventory.yaml"
    except NoHomeFolder:
        own = SYSTEM
    return next((path for path in (own, SYSTEM) if path.exists()), None)
