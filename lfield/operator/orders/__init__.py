"""Orders to stop and to pause that a desk gives as datagrams, beside its connections."""
