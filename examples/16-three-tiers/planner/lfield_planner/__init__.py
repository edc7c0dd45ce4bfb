"""The driver 'planner': devices of the type Planner. See ../../README.md."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="planner",
    package="lfield_planner",
    driver="lfield_planner.driver:PlannerDriver",
    requires=("highspy",),
)
