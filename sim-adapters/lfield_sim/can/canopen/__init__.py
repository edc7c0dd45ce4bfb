"""CANopen (CiA 301): object dictionary, SDO, PDO, and the node."""
