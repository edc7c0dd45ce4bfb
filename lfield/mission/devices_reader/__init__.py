"""Parts of the reader of devices files: one device, and frames."""
