"""What a pair of sessions shows, as one picture."""

from pathlib import Path

import numpy as np

from palpate.common.files import whole_file
from palpate.render import palette
from palpate.teleop.merged_sessions import ForceComparison, MergedSessions


def draw(path: Path, merged: MergedSessions, felt: ForceComparison, modelled: ForceComparison) -> Path:
    """Write a PNG: forces over time, felt over real force, and the link; returns the path.

    Args:
        path: of the file, replaced if it is there.
        merged: both sessions.
        felt: what was felt, and what the real object would have answered.
        modelled: what the models answer to the follower's presses, and what it measured.

    Raises:
        InputError: it cannot be written.
    """
    import matplotlib as mpl  # noqa: PLC0415, half a second that nobody else should wait for

    mpl.rcdefaults()  # not what a matplotlibrc in the current folder says
    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(3, 1, figsize=(11, 10), layout="constrained")
    start_s = float(merged.haptic["time_s"][0])
    over_time, over_force, line = axes
    haptic, exchanges = merged.haptic, merged.exchanges
    over_time.plot(haptic["time_s"] - start_s, haptic["force_n"], color=palette.MODEL, lw=1.2, label="felt")
    real_n = np.full(len(haptic), np.nan)
    real_n[np.searchsorted(haptic["time_s"], felt.time_s)] = felt.real_n
    look = {"color": palette.TRUTH, "lw": 1.0, "ls": (0, (4, 2))}
    over_time.plot(
        haptic["time_s"] - start_s, real_n, label="the real object, pressed by the same hand", **look
    )
    for event, data in merged.feels():
        over_time.axvline(event.time_s - start_s, color=palette.BASE, lw=0.8)
        verdict = f", {data['verdict']}" if data["verdict"] else ""
        over_time.annotate(
            f"estimate {data['revision']}{verdict}",
            (event.time_s - start_s, 1.01),
            xycoords=("data", "axes fraction"),
            fontsize=7,
            rotation=40,
            color=palette.BASE,
        )
    over_time.set(xlabel="time of the leader [s]", ylabel="force [N]")
    over_time.set_ylim(top=1.2 * over_time.get_ylim()[1])  # room for the legend above the presses
    over_time.legend(loc="upper left", frameon=False, ncols=2)
    over_force.plot(
        felt.real_n, felt.felt_n, ".", ms=2, color=palette.MODEL, label=f"felt over real: {felt.summary()}"
    )
    over_force.plot(
        modelled.real_n,
        modelled.felt_n,
        ".",
        ms=2,
        color=palette.MEASURED,
        label=f"model over the follower's measurement: {modelled.summary()}",
    )
    most = max(float(one.max(initial=1.0)) for one in (felt.real_n, modelled.real_n))
    over_force.plot((0.0, most), (0.0, most), color=palette.BASE, lw=0.8)
    over_force.set(xlabel="real force [N]", ylabel="felt, or modelled [N]")
    over_force.legend(loc="upper left", frameon=False)
    link = merged.leader.samples("link")
    line.plot(
        link["time_s"] - start_s,
        1e3 * link["age_s"],
        color=palette.MEASURED,
        lw=1.0,
        label="age of the newest message",
    )
    drift_ms = 1e3 * (exchanges[:, 1] - merged.offset_s)
    line.plot(
        exchanges[:, 0] - start_s,
        drift_ms,
        color=palette.FLOOR,
        lw=1.0,
        label="drift of the follower's clock",
    )
    line.set(xlabel="time of the leader [s]", ylabel="link [ms]")
    line.legend(loc="upper left", frameon=False)
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
    try:
        with whole_file(path) as unfinished:
            figure.savefig(unfinished, dpi=110, format="png")
    finally:
        plt.close(figure)
    return path
