"""The outcome of each coordinator, from the records of the hosts that answered. Pure."""
