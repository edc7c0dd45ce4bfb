"""Simulated computers on virtual time: sockets, pipes and clocks for the real code of a robot."""
