"""Files as machines and people write them, of presses with known truth: 800 N/m and 4 N s/m."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import openpyxl
from scipy.ndimage import gaussian_filter1d

from tests.files import saved

STIFFNESS, DAMPING, CUBIC = 800.0, 4.0, 4e7
SPEEDS_M_S = (4e-3, 8e-3, 16e-3, 12e-3)
_DEPTH_M, _AWAY_M, _RATE_HZ, _NOISE_N = 4e-3, 1e-3, 250, 0.01


@cache
def presses(speeds=SPEEDS_M_S, cubic=0.0):
    """Time [s], displacement [m] and force [N] of presses one after the other, each with a hold."""
    parts = []
    for speed in speeds:
        way = np.linspace(-_AWAY_M, _DEPTH_M, int((_DEPTH_M + _AWAY_M) / speed * _RATE_HZ), endpoint=False)
        rest = int(0.2 * _RATE_HZ)
        parts += [np.full(rest, -_AWAY_M), way, np.full(2 * rest, _DEPTH_M), way[::-1]]
    x = gaussian_filter1d(np.concatenate([*parts, np.full(50, -_AWAY_M)]), 3.0)
    t = np.arange(len(x)) / _RATE_HZ
    force = STIFFNESS * x + DAMPING * np.gradient(x, t) + cubic * x**3
    noise = np.random.default_rng(len(x)).normal(0.0, _NOISE_N, len(x))
    return t, x, np.where(x > 0.0, force, 0.0).clip(0.0) + noise


def lines(columns, delimiter=",", form="{:.5f}"):
    return "".join(
        delimiter.join(form.format(value) for value in row) + "\r\n" for row in zip(*columns, strict=True)
    )


def comma(text):
    return text.replace(".", ",")


def si_prefixed(t, x, f):
    return t, 1e3 * x, f


def plain(folder):
    """A spreadsheet's CSV with units in brackets, and a byte order mark."""
    path = folder / "press.csv"
    path.write_text("Time [s],Displacement [mm],Force (N)\n" + lines(si_prefixed(*presses())), "utf-8-sig")
    return path


def zwick(folder):
    """testXpert in German: cp1252, semicolons, decimal commas, units below the names."""
    text = "Prüfprotokoll;;\nPrüfer;Müller;\nPrüftemperatur;23,5;°C\n\n"
    text += "Prüfzeit;Standardweg;Standardkraft\ns;mm;N\n" + comma(lines(si_prefixed(*presses()), ";"))
    return saved(folder / "Schaum 12.TRA", text.encode("cp1252"))


def labview(folder):
    """A LabVIEW measurement file with a decimal comma; units stand far above the names."""
    text = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\n"
    text += (
        "***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t999\t999\t\nDate\t2024/05/02\t2024/05/02\t\n"
    )
    text += "Y_Unit_Label\tNewton\tMillimeters\t\nX_Dimension\tTime\tTime\t\nX0\t0,0E+0\t0,0E+0\t\n"
    text += "Delta_X\t0,004\t0,004\t\n***End_of_Header***\t\t\t\nX_Value\tLoad Cell\tStroke\tComment\n"
    t, x, f = presses()
    return saved(folder / "press.lvm", text + comma(lines((t, f, 1e3 * x), "\t", "{:.6f}")))


def excel(folder):
    """A workbook with an overview and one sheet for each specimen."""
    book = openpyxl.Workbook()
    book.active.append(["Overview", "mean stiffness", 801.2])
    for number, speed in enumerate(SPEEDS_M_S, 1):
        sheet = book.create_sheet(f"Probe {number}")
        for row in (["Specimen", number], [], ["Time", "Extension", "Load"], ["s", "mm", "N"]):
            sheet.append(row)
        for row in zip(*si_prefixed(*presses((speed,))), strict=True):
            sheet.append([float(value) for value in row])
    book.save(folder / "series.xlsx")
    return folder / "series.xlsx"


def side_by_side(folder):
    """Each specimen in columns of its own, below its name; an empty column between; they differ in length."""
    tests = [list(zip(*si_prefixed(*presses((speed,))), strict=True)) for speed in SPEEDS_M_S]
    head = [("Time", "Extension", "Load"), ("s", "mm", "N")]
    sheet = openpyxl.Workbook()
    sheet.active.append([cell for name in "ABCD" for cell in (f"Foam {name}", None, None, None)])
    for row in range(max(map(len, tests)) + 2):
        cells = [[*head, *test][row] if row < len(test) + 2 else (None,) * 3 for test in tests]
        plain = [
            cell if isinstance(cell, str | None) else float(cell)
            for three in cells
            for cell in (*three, None)
        ]
        sheet.active.append(plain[:-1])
    sheet.save(folder / "side by side.xlsx")
    return folder / "side by side.xlsx"


def by_the_clock(folder):
    """The time of day, past midnight; kN; the preamble's degrees in cp1252."""
    t, x, f = presses()
    clock = [(86390.0 + each) % 86400.0 for each in t]
    said = [f"{s // 3600:02.0f}:{s // 60 % 60:02.0f}:{s % 60:06.3f}".replace(".", ",") for s in clock]
    rows = zip(said, comma(lines((1e3 * x, f / 1e3), ";", "{:.7f}")).split("\r\n"), strict=False)
    text = "Temperatur;23,4 °C\nUhrzeit (hh:mm:ss,sss);Verlängerung (mm);Last (kN)\n"
    path = folder / "clock.csv"
    path.write_bytes((text + "".join(f"{time};{row}\n" for time, row in rows)).encode("cp1252"))
    return path


def one_file_a_run(folder):
    """A folder with one file for each speed; the material stiffens."""
    place = folder / "runs"
    place.mkdir()
    for number, speed in enumerate(SPEEDS_M_S, 9):
        t, x, f = presses((speed,), CUBIC)
        text = "t (s);x (mm);F (N)\n" + lines((t, 1e3 * x, f), ";")
        (place / f"run{number}.csv").write_text(text)
    return place


def savetxt(folder):
    """numpy's own: a comment for a header, blanks between cells; the clock misses samples and is uneven."""
    t, x, f = presses()
    kept = np.random.default_rng(3).random(len(t)) > 0.05
    columns = np.column_stack([t, 1e6 * x, f])[kept]
    path = folder / "bench.asc"
    np.savetxt(path, columns, header="time [s]  depth[um] load [N]", fmt="%11.6f")
    return path


def joint_log(folder):
    """A motor's log: milliseconds, degrees, mA; 0.02 N m s^2 and 0.1 N m s for 1 N m an ampere."""
    t = np.arange(0.0, 12.0, 0.004)
    angle = 0.8 * np.sin(2.0 * t) + 0.4 * np.sin(5.1 * t) + 0.1 * np.sin(13.0 * t)
    rate = 1.6 * np.cos(2.0 * t) + 2.04 * np.cos(5.1 * t) + 1.3 * np.cos(13.0 * t)
    acceleration = -3.2 * np.sin(2.0 * t) - 10.404 * np.sin(5.1 * t) - 16.9 * np.sin(13.0 * t)
    current = 0.02 * acceleration + 0.1 * rate + np.random.default_rng(5).normal(0.0, 0.005, len(t))
    columns = (1e3 * t, np.degrees(angle), 1e3 * current, np.full(len(t), 24.1))
    path = folder / "axis.csv"
    path.write_text("timestamp_ms,joint_1_angle_deg,Motor Current 1 [mA],Bus voltage [V]\n" + lines(columns))
    return path


PRESSED = {"stiffness.k": (STIFFNESS, 0.005), "damping.c": (DAMPING, 0.05)}
STIFFENING = {"stiffness.k": (STIFFNESS, 0.05), "cubic_stiffness.k3": (CUBIC, 0.05)}
MOVED = {"inertia.m": (0.02, 0.03), "viscous_friction.d": (0.1, 0.03)}
LABORATORIES: dict[Callable[[Path], Path], tuple[str, dict[str, tuple[float, float]]]] = {
    plain: ("adequate", PRESSED),
    one_file_a_run: ("missing", STIFFENING),
    savetxt: ("adequate", PRESSED),
    joint_log: ("adequate", MOVED),
}
"""Each with the verdict on its channel, and parameters with the share by which they may be off."""
