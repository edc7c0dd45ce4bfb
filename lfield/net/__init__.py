"""Transports: the only place with sockets."""
