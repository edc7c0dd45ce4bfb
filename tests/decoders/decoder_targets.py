"""All decoders of external bytes, by name."""

from __future__ import annotations

import targets_of_authority
import targets_of_drivers
import targets_of_files
import targets_of_guards
import targets_of_links
import targets_of_operators

TARGET_MODULES = (
    targets_of_links,
    targets_of_files,
    targets_of_guards,
    targets_of_drivers,
    targets_of_authority,
    targets_of_operators,
)
TARGETS = {target.name: target for room in TARGET_MODULES for target in room.TARGETS}
