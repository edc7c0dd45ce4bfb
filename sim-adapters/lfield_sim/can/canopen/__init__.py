"""CANopen (CiA 301): object dictionary and SDO, PDO, and the node that has them."""
