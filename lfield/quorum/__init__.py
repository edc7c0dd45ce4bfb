"""Leases and fences: who may act for a team, and who goes on with a coordinator whose host is gone."""
