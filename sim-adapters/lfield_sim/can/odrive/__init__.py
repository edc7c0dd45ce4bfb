"""An ODrive axis by CANSimple, the CAN protocol of its firmware 0.6."""
