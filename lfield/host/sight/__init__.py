"""What is told of a host to whoever watches it: the stream of events, what each watcher hears, causes."""
