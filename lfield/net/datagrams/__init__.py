"""Datagrams of orders to stop and to pause: the sockets of a host, beside those that it listens at."""
