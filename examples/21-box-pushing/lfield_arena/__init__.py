"""The driver 'arena': devices of the type Omni, small robots on a plane with objects (README.md)."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="arena",
    package="lfield_arena",
    driver="lfield_arena.driver:ArenaDriver",
    extra="",
    kit="lfield_arena.kit:KIT",
)
