"""A mission in one process on virtual time: real hosts, guards, drivers and fakes, for its tests."""
