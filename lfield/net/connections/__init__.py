"""Connection establishment: name resolution, dialling with back-off, listening sockets."""
