"""Dynamixel servos of the X series on a pseudo terminal, with the simulated arm behind them."""
