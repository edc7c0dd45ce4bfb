"""Missions in one process on virtual time, with real hosts, guards and drivers, and simulated devices."""
