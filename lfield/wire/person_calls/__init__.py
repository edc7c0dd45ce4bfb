"""Messages of persons who call portals."""
