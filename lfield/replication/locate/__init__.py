"""What became of each coordinator, from the records of the hosts that answered. Pure."""
