"""Leases, fencing tokens and failover of coordinators by a majority of the team."""
