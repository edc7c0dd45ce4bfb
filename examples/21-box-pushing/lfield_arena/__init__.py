"""The driver 'arena' for robots on a plane (Omni) and their referee (Whistle). See README.md."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="arena",
    package="lfield_arena",
    driver="lfield_arena.driver:ArenaDriver",
    manifests=("manifest.yaml", "whistle.yaml"),
    extra="",
    kit="lfield_arena.kit:KIT",
)
