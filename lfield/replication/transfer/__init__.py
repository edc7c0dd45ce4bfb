"""Two-phase hand-over of coordinators: sender, receiver, records, epochs, terminations. Pure."""
