"""What a vehicle is sent to move: orders, moving targets, their stream, and the speed that is commanded."""
