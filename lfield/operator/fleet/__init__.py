"""The desk's side of the services of a team: transfers, ballots, commands."""
