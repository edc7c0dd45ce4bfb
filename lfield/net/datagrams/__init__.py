"""UDP datagrams with stop and pause orders: the sockets of a host, beside its listening sockets."""
