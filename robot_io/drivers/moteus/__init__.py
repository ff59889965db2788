"""moteus controllers of mjbots on a CAN FD bus."""
