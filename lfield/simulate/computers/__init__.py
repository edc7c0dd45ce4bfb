"""Computers on virtual time: models of sockets, pipes and clocks, under what runs on a robot."""
