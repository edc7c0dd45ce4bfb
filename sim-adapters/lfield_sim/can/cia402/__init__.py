"""A CiA 402 drive: motor control, modes of operation, states; on a CANopen node."""
