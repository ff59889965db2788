"""ODrive axes on a CAN bus, through CANSimple."""
