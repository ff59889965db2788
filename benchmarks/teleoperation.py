"""What an operator feels through five couplings, over links with delay, jitter and loss.

A hand presses on an object through leader, link and follower, waits until all has settled, and the force it
feels is held against that of the real object at the depth of its own tip. "free air" is the largest force
before the first contact (nothing should be felt), "given back" the energy that the hand got beyond what it
had put in (a passive coupling gives none). All in simulation, on one axis.
"""

from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

import matplotlib as mpl
import numpy as np
from command_line import arguments
from rich.console import Console
from rich.table import Column, Table

from benchmarks.teleop.link import LinkFaults
from benchmarks.teleop.measures import FREQUENCIES_HZ, NAMES, Felt, impedance_ratio, press
from benchmarks.teleop.run import DT_S
from benchmarks.teleop.udp import UdpLink

mpl.use("Agg")
import matplotlib.pyplot as plt

DELAYS_S = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
USUAL_S = 0.1
LOSSES = (0.01, 0.05, 0.2)
LINKS = (
    *(LinkFaults(delay) for delay in DELAYS_S),
    *(LinkFaults(USUAL_S, 0.0, loss) for loss in LOSSES),
    *(LinkFaults(USUAL_S, jitter) for jitter in (0.02, 0.1)),
)
WORST = LinkFaults(1.0, 0.2, 0.2)
CASES = {"spring and damper": (*LINKS, WORST), "soft sphere": (LinkFaults(), LinkFaults(USUAL_S), WORST)}
GOAL = 0.05
WIDTH = 140  # of the tables
COLOURS = dict(zip(NAMES, ("#d55e00", "#cc79a7", "#e69f00", "#0072b2", "#009e73"), strict=True))
HEADER = (
    *("coupling", "felt [N]", "+-", "real [N]", "error", "follower [N]"),
    *("free air [N]", "given back, mJ", ""),
)
Results = dict[tuple[str, str, LinkFaults], Felt]
Ratios = dict[tuple[str, LinkFaults], np.ndarray]


def main() -> None:
    """Measure, print and draw."""
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, default=Path("teleoperation.png"), help="the picture")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--udp", action="store_true", help="instead: in real time, over UDP on loopback")
    options = parser.parse_args()
    if options.udp:
        Console(width=WIDTH).print(real_link_table())
        return
    cases = [(name, thing, link) for thing, links in CASES.items() for link in links for name in NAMES]
    with ProcessPoolExecutor(options.jobs) as pool:
        results = dict(zip(cases, pool.map(press, *zip(*cases, strict=True)), strict=True))
        tones = list(product(NAMES, (LinkFaults(0.0), LinkFaults(USUAL_S))))
        ratios = dict(zip(tones, pool.map(impedance_ratio, *zip(*tones, strict=True)), strict=True))
    console = Console(width=WIDTH)
    for thing, links in CASES.items():
        for link in links:
            console.print(force_table(results, thing, link))
    console.print(impedance_table(ratios))
    console.print(summary(results))
    draw(results, ratios, options.out)
    console.print(f"picture: {options.out}")


def force_table(results: Results, thing: str, link: LinkFaults) -> Table:
    """All couplings on one object over one link."""
    columns = (Column(name, justify="left" if name in {"coupling", ""} else "right") for name in HEADER)
    table = Table(*columns, title=f"{thing}; {link} (delay + jitter, loss)")
    for name in NAMES:
        felt = results[name, thing, link]
        numbers = (
            f"{felt.felt_n:.2f}",
            f"{felt.spread_n:.2f}",
            f"{felt.real_n:.2f}",
            f"{100 * felt.error:+.1f} %",
        )
        others = (f"{felt.follower_n:.2f}", f"{felt.free_air_n:.2f}", f"{1e3 * felt.given_back_j:.2f}")
        table.add_row(name, *numbers, *others, felt.verdict)
    return table


def real_link_table() -> Table:
    """The link in one process beside a real one with the same faults."""
    faults = LinkFaults(USUAL_S, 0.02, 0.05)
    titles = (
        "coupling",
        "felt, simulated link [N]",
        "felt, UDP [N]",
        "age of packets over UDP in steps: median, 99 %",
    )
    table = Table(*titles, title=f"spring and damper; {faults} (delay + jitter, loss)")
    for name in NAMES:
        simulated = press(name, "spring and damper", faults)
        with UdpLink(faults) as link:
            real = press(name, "spring and damper", faults, link=link)
        median, oldest = np.percentile(link.ages, [50.0, 99.0])
        forces = (f"{felt.felt_n:.2f} +- {felt.spread_n:.2f}" for felt in (simulated, real))
        table.add_row(name, *forces, f"{median:.0f}, {oldest:.0f}")
    return table


def impedance_table(ratios: Ratios) -> Table:
    """Impedance felt over that of the object: size and angle."""
    columns = (Column(f"{hz:g} Hz", justify="right") for hz in FREQUENCIES_HZ)
    table = Table("coupling", "delay", *columns, title="impedance felt over impedance there")
    for (name, link), ratio in ratios.items():
        table.add_row(
            name,
            f"{1e3 * link.delay_s:.0f} ms",
            *(f"{abs(z):.2f} {np.angle(z, deg=True):+.0f}°" for z in ratio),
        )
    return table


def summary(results: Results) -> str:
    """The goal of 5 %, by coupling."""
    lines = []
    for name in NAMES:
        own = [felt for (coupling, _, _), felt in results.items() if coupling == name]
        within = sum(not felt.verdict and abs(felt.error) <= GOAL for felt in own)
        worst_j = max(felt.given_back_j for felt in own)
        lines.append(
            f"{name}: within {100 * GOAL:.0f} % in {within} of {len(own)}; makes energy in "
            f"{sum(felt.verdict == 'makes energy' for felt in own)}, not settled in "
            f"{sum(felt.verdict == 'not settled' for felt in own)}; at most {1e3 * worst_j:.2f} mJ given back"
        )
    return "\n".join(lines)


def draw(results: Results, ratios: Ratios, path: Path) -> None:
    """Force over delay and loss, impedance over frequency, energy over time."""
    figure, ((by_delay, by_loss), (by_tone, by_time)) = plt.subplots(2, 2, figsize=(11.0, 8.0))
    thing = next(iter(CASES))
    delays = [LinkFaults(delay) for delay in DELAYS_S]
    losses = [LinkFaults(USUAL_S, 0.0, loss) for loss in (0.0, *LOSSES)]
    for name, colour in COLOURS.items():
        style = {"color": colour, "marker": "o", "markersize": 4, "label": name}
        _draw_force(
            by_delay,
            [1e3 * link.delay_s for link in delays],
            [results[name, thing, link] for link in delays],
            style,
        )
        _draw_force(
            by_loss,
            [1e2 * link.loss for link in losses],
            [results[name, thing, link] for link in losses],
            style,
        )
        for (coupling, link), ratio in ratios.items():
            if coupling == name:
                dashes = "-" if link.delay_s else ":"
                by_tone.loglog(FREQUENCIES_HZ, np.abs(ratio - 1.0), color=colour, linestyle=dashes)
        balance = results[name, thing, LinkFaults(USUAL_S)].balance_j
        by_time.plot(np.arange(len(balance)) * DT_S, 1e3 * balance, color=colour)
    for axes in (by_delay, by_loss):
        axes.axhspan(1.0 - GOAL, 1.0 + GOAL, color="#009e73", alpha=0.15)
        axes.set_ylim(-0.05, 2.05)
        axes.set_ylabel("force felt / force of the real object")
    by_delay.set_xscale("symlog", linthresh=20.0)
    by_delay.set_xticks([0, 20, 50, 100, 200, 500, 1000], ["0", "20", "50", "100", "200", "500", "1 s"])
    by_delay.set(
        xlabel="delay each way [ms]",
        title="after convergence (x: makes energy, o: not settled)",
        xlim=(-2.0, 1200.0),
    )
    by_loss.set(
        xlabel=f"packets lost [%], at {1e3 * USUAL_S:.0f} ms", title="after convergence (x: makes energy)"
    )
    by_delay.legend(fontsize=8)
    by_tone.set(
        xlabel="frequency [Hz]",
        ylabel="relative error of the impedance felt",
        title="without delay (dotted) and with 100 ms",
    )
    by_time.set_yscale("symlog", linthresh=10.0)
    by_time.axhline(0.0, color="k", linewidth=0.5)
    by_time.set(
        xlabel="time [s]", ylabel="energy given to the hand [mJ]", title="100 ms: above 0 is produced energy"
    )
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def _draw_force(axes: plt.Axes, at: list[float], felt: list[Felt], style: dict[str, object]) -> None:
    """A line through what came to rest, marks at the top for the rest."""
    shares = np.array([np.nan if value.verdict else value.error + 1.0 for value in felt])
    axes.plot(at, shares, **style)
    for mark, verdict in (("x", "makes energy"), ("o", "not settled")):
        wrong = [x for x, value in zip(at, felt, strict=True) if value.verdict == verdict]
        axes.plot(wrong, [1.95] * len(wrong), mark, color=style["color"], fillstyle="none")


if __name__ == "__main__":
    main()
