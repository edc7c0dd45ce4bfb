"""One host of a team: its directory, mobility, devices and life."""
