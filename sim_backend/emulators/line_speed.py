"""Whether both ends of a pseudo terminal speak at the same speed, which the terminal itself does not mind."""

import termios


def heard_at(master: int, baud_rate: int | None) -> bool:
    """Whether what the host sends makes sense to a device at `baud_rate` [bit/s]; any does for None.

    Args:
        master: file of the device's end; the host has set the speed at the other one.
        baud_rate: of the device. One that has no number in termios cannot be told from others.
    """
    wanted = getattr(termios, f"B{baud_rate}", None)
    return wanted is None or termios.tcgetattr(master)[4] == wanted
