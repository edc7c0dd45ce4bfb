"""A team in one process on virtual time, with faults on purpose."""
