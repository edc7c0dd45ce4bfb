"""Who may do what: identities, the authority of a team, its keys, and when they are good."""
