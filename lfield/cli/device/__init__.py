"""Commands to set up a robot."""
