"""Missions in one process on virtual time, with real hosts, guards, drivers and fakes, for tests."""
