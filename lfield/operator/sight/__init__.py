"""What a person sees of a running team: the streams of its hosts, put together and kept in order."""
