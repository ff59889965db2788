"""Experiments that set apart what a diagnosis leaves undecided: designed, rehearsed, and run by the arm."""
