"""DroneCAN nodes: transfers, messages, dynamic node ids, and devices. CAN 2.0B only."""
