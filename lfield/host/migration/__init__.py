"""Coordinators of a host between arrival and call: effects, acknowledgements, init barrier."""
