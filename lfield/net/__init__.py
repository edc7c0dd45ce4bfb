"""Network transports and links: the only package with network sockets."""
