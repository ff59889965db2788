"""Feetech servos of the STS series on a pseudo terminal, with the simulated arm behind them."""
