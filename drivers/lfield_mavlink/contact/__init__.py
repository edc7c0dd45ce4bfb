"""One vehicle heard and asked: what is known of it, commands and waiting, streams, how good its link is."""
