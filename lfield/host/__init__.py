"""One host of a team, from start to stop."""
