"""Who waits until its messages are taken: whoever is no host of the team."""
