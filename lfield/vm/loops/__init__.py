"""Loops of resources: their ticks, and which loop controls the devices."""
