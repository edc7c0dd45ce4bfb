"""Transport: endpoints and links, packets, signatures, and the choice of a link per vehicle."""
