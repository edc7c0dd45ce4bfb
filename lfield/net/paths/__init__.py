"""Ways to a host and from it: names, attempts to connect, back-off, listening sockets."""
