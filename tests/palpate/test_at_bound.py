"""Parameters at a search end or beyond a physical bound are marked wherever shown."""

import numpy as np
import pytest
from rich.console import Console

from palpate.estimation.effect import Parameter
from palpate.estimation.study import ModelStudy
from palpate.render.build import result_view
from palpate.render.terminal import print_stages
from tests.few_effects import try_few_effects
from tests.palpate.cli import run
from tests.palpate.presses import write_presses


@pytest.mark.parametrize(
    ("log", "value", "at_bound"),
    [
        (True, 1e-6, True),
        (True, 1.0005e-6, True),
        (True, 2e-6, False),
        (True, 0.9999, True),
        (False, 1e-6, True),
        (False, 2e-3, False),
        (False, 1.0, True),
    ],
)
def test_ends_of_a_search_are_bounds(log, value, at_bound):
    assert Parameter("p", "m", 1e-6, 1.0, (1e-3, 1e-1), log=log).at_bound(value) is at_bound


def test_unresolved_presliding_is_marked_wherever_it_is_shown(capsys):
    """Friction that turns round within one step of the position: its presliding runs to the least one."""
    rng, t, runs = np.random.default_rng(0), np.arange(0, 2, 0.002), []
    for number, speed in enumerate((4.0, 7.0, 9.0)):
        x, v = 0.004 * (1 - np.cos(speed * t)), 0.004 * speed * np.sin(speed * t)
        force = 2000 * x + 5 * v + 2 * np.sign(v) * (x > 1e-4) + rng.normal(0, 0.01, len(t))
        runs.append({"time_s": t, "displacement_m": x, "force_N": force, "run": np.full(len(t), number)})
    study = ModelStudy({name: np.concatenate([one[name] for one in runs]) for name in runs[0]})
    change = study.add("dry_friction")
    name = "dry_friction.presliding"
    (kept,) = [one for one in change.revisions if one.added == "dry_friction"]
    assert kept.parameters[name].at_bound
    assert change.result.stages[-1].parameters[name].at_bound
    print_stages(Console(width=120), result_view(change.result))
    (line,) = [line for line in capsys.readouterr().out.splitlines() if name in line]
    assert "at its bound" in line
    (line,) = [line for line in str(study.fit("contact", ["dry_friction"])).splitlines() if name in line]
    assert "at its bound" in line


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A data file of presses onto a spring that drives instead of damping."""
    folder = tmp_path_factory.mktemp("driven")
    return write_presses(folder / "driven.csv", force_of=lambda x, v: 900 * x - 6 * v)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (("compare",), "kelvin_voigt does not fit contact: "),
        (("compare", "--json"), "damping.c would be below"),
        (("add", "bias"), "kelvin_voigt + bias does not fit contact: "),
        (("diagnose",), "delay (approximate) is missing from the base model"),
        (("estimate",), "outside the physical bounds"),
    ],
)
def test_fit_with_negative_damping_is_reported_by_every_command(
    tmp_path, monkeypatch, without_figures, driven, command, said
):
    try_few_effects(monkeypatch, "delay")
    result = run(command[0], driven, *command[1:], *(("--out", tmp_path) if command[0] == "add" else ()))
    told = " ".join(result.stdout.split())
    assert said in told
    words = "damping.c would be below the physical bound, 0 N s/m: the model lacks"
    assert command[0] in {"diagnose", "estimate"} or words in told
    assert " fits " not in told
