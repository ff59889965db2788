"""What an operator feels through five couplings, over links with delay, jitter and loss.

A hand presses on an object through leader, link and follower, waits until all has settled, and the force it
feels is held against that of the real object at the depth of its own tip. "free air" is the largest force
before the first contact (nothing should be felt), "given back" the energy that the hand got beyond what it
had put in (a passive coupling gives none). All in simulation, on one axis.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import matplotlib as mpl
import numpy as np
from command_line import arguments
from rich.console import Console
from rich.table import Column, Table
from scipy.optimize import least_squares
from teleop_simulation import (
    DT_S,
    START_M,
    HandArm,
    LinkFaults,
    SimulatedLink,
    SimulatedObject,
    SoftSphere,
    SpringDamper,
    given_back_j,
    presses,
    run,
)

from palpate.control.teleop.couplings import Coupling, Packet
from palpate.control.teleop.model_mediated import COUPLINGS, ObjectModel, model_mediated
from palpate.control.teleop.virtual_object import hunt_crossley

mpl.use("Agg")
import matplotlib.pyplot as plt

NAMES = tuple(coupling.name for coupling in COUPLINGS)
OBJECTS: dict[str, SimulatedObject] = {
    "spring and damper": SpringDamper(1500.0, 10.0),
    "soft sphere": SoftSphere(22_600.0, 1.5, 1.5),
}
PRESSES_S = ((1.0, 2.5), (9.0, 21.0))  # a first touch, and one to feel with
DURATION_S = 20.0
LAST = slice(-1000, None)  # after convergence
STEADY_N = 0.5  # standard deviation of a force that has settled
MADE_J = 0.01  # more is given back by no passive one, nor by rounding
FREQUENCIES_HZ = np.array([0.5, 1.0, 2.0, 4.0, 8.0, 16.0])
AMPLITUDE_M = 1e-4
DEPTH_M = 0.005
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


@dataclass(frozen=True)
class FeltForce:
    """What an operator felt who pressed and waited."""

    felt_n: float  # mean of the last second
    spread_n: float  # standard deviation over it
    real_n: float  # of the real object at the depth of the operator's own tip
    follower_n: float  # on the follower's tool in that second
    free_air_n: float  # largest force before the virtual or the real object was touched
    given_back_j: float  # to the hand, above what it had put in
    balance_j: np.ndarray  # energy given to the hand less what it put in, at each step

    @property
    def verdict(self) -> str:
        """What is wrong with it, empty if it came to rest and made no energy."""
        if self.given_back_j > MADE_J:
            return "makes energy"
        return "not settled" if self.spread_n > STEADY_N else ""

    @property
    def error(self) -> float:
        """Relative error of the force felt."""
        return self.felt_n / self.real_n - 1.0 if self.real_n > 0.0 else float("nan")


def press(name: str, thing: str, faults: LinkFaults, seed: int = 0) -> FeltForce:
    """Press twice through the coupling of this name, and wait."""
    target = OBJECTS[thing]
    hand = HandArm(presses(0.02, -START_M, PRESSES_S))
    trace = run(coupling_for(name, thing), target, hand, SimulatedLink(faults, seed), DURATION_S, seed)
    depth, rate = trace["hand_m"][LAST], trace["hand_m_s"][LAST]
    outside = trace["hand_m"][: np.argmax(trace["hand_m"] > 0.0)]
    balance = given_back_j(trace)
    return FeltForce(
        felt_n=trace["felt_n"][LAST].mean(),
        spread_n=trace["felt_n"][LAST].std(),
        real_n=float(np.mean([target.push_n(x, v) for x, v in zip(depth, rate, strict=True)])),
        follower_n=trace["object_n"][LAST].mean(),
        free_air_n=np.abs(trace["felt_n"][: len(outside)]).max(),
        given_back_j=max(0.0, balance.max()),
        balance_j=balance,
    )


def impedance_ratio(name: str, faults: LinkFaults, seed: int = 0) -> np.ndarray:
    """Impedance felt over the spring and damper's own, complex, at `FREQUENCIES_HZ`.

    The operator's tip is moved: it touches once, comes back, and then trembles inside at all frequencies.
    """
    plan = presses(DEPTH_M, -START_M, PRESSES_S)
    omega = 2.0 * np.pi * FREQUENCIES_HZ
    phase = np.arange(len(omega)) ** 2 * 1.3  # so that the peaks do not coincide

    def motion(time_s: float) -> tuple[float, float]:
        x, v = plan(time_s)
        if time_s < PRESSES_S[1][0] + 1.0:
            return x, v
        angle = omega * time_s + phase
        return x + AMPLITUDE_M * np.sin(angle).sum(), v + AMPLITUDE_M * (omega * np.cos(angle)).sum()

    thing = "spring and damper"
    trace = run(
        coupling_for(name, thing), OBJECTS[thing], motion, SimulatedLink(faults, seed), DURATION_S, seed
    )
    last = slice(-round(4.0 / DT_S), None)  # whole periods of all
    tones = np.exp(-1j * np.outer(omega, trace["time_s"][last]))
    felt = (tones @ trace["felt_n"][last]) / (tones @ trace["hand_m"][last])
    return felt / (1500.0 + 10.0j * omega)


def coupling_for(name: str, thing: str) -> Coupling:
    """The coupling of this name; the model-mediated one with a model that can describe the object."""
    if name == "model-mediated" and thing == "soft sphere":
        return model_mediated(HUNT_CROSSLEY)
    return COUPLINGS[NAMES.index(name)]


def _fit_hunt_crossley(samples: np.ndarray) -> Packet:
    """Stiffness [N/m^n], damping [N s/m^(n+1)], exponent and surface [m] by least squares."""
    position, velocity, force = samples.T

    def error_n(guess: np.ndarray) -> np.ndarray:
        log_k, loss, exponent, surface_mm = guess
        depth = np.maximum(position - 1e-3 * surface_mm, 1e-9)
        return np.exp(log_k) * depth**exponent * (1.0 + loss * velocity) - force

    log_k, loss, exponent, surface_mm = least_squares(
        error_n, [np.log(1e4), 0.5, 1.4, 1e3 * position.min()]
    ).x
    stiffness = float(np.exp(log_k))
    return stiffness, stiffness * float(loss), float(exponent), 1e-3 * float(surface_mm)


HUNT_CROSSLEY = ObjectModel(
    fit=_fit_hunt_crossley,
    law=lambda parameters: (hunt_crossley(*parameters[:3]), parameters[3]),
    guess=(1e4, 1e4, 1.5, 0.0),
)
Results = dict[tuple[str, str, LinkFaults], FeltForce]
Ratios = dict[tuple[str, LinkFaults], np.ndarray]


def main() -> None:
    """Measure, print and draw."""
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, default=Path("teleoperation.png"), help="the picture")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    options = parser.parse_args()
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
        further = (f"{felt.follower_n:.2f}", f"{felt.free_air_n:.2f}", f"{1e3 * felt.given_back_j:.2f}")
        table.add_row(name, *numbers, *further, felt.verdict)
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


def _draw_force(axes: plt.Axes, at: list[float], felt: list[FeltForce], style: dict[str, object]) -> None:
    """A line through what came to rest, marks at the top for the rest."""
    shares = np.array([np.nan if value.verdict else value.error + 1.0 for value in felt])
    axes.plot(at, shares, **style)
    for mark, verdict in (("x", "makes energy"), ("o", "not settled")):
        wrong = [x for x, value in zip(at, felt, strict=True) if value.verdict == verdict]
        axes.plot(wrong, [1.95] * len(wrong), mark, color=style["color"], fillstyle="none")


if __name__ == "__main__":
    main()
