"""Which orders to stop and to pause a host executes."""
