"""The inventory of a team: its hosts, their addresses, and how they are reached for provisioning."""
