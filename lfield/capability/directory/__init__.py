"""The directory of agents and their attributes on one host, and its replication between hosts."""
