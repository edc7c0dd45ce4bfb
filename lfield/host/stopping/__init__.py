"""Orders to stop and to pause, carried out: those that come over links, and those that come as datagrams."""
