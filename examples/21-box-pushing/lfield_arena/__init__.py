"""The driver 'arena': Omni, a small robot on a plane with objects, and Whistle, its referee (README.md)."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="arena",
    package="lfield_arena",
    driver="lfield_arena.driver:ArenaDriver",
    manifests=("manifest.yaml", "whistle.yaml"),
    extra="",
    kit="lfield_arena.kit:KIT",
)
