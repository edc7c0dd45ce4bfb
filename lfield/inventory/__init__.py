"""The inventory of a team: its hosts, their addresses, and their access for provisioning."""
