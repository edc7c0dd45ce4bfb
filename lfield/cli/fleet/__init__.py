"""Subcommands for the services of the robots: inventory, provisioning, push, start, stop, status."""
