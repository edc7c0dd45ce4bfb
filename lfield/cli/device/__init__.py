"""Commands for whoever sets up a robot."""
