"""Calibrations: the file, its checks, and the devices that it corrects."""
