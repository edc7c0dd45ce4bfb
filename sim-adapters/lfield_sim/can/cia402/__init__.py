"""A drive by CiA 402: what its motor can be told, modes of operation, states; on a CANopen node."""
