"""The read model of the team: snapshots and events of hosts in, the state of hosts and team out. Pure."""
