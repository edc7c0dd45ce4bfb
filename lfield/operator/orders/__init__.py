"""Stop and pause orders as signed datagrams, sent in parallel to links."""
