"""Effects found in many measurements together: false alarms, power, and a real small effect."""

import numpy as np
import pyarrow as pa
import pytest

import palpate
from palpate.batches.common_effects import LEVEL, best_effect, find_common_effects
from tests.palpate.cli import run
from tests.palpate.presses import NOISE_N, write_presses


def gains_table(gains):
    """Rows of `gains`, a dict of candidates with an array (measurements,) each."""
    rows = [
        {"address": str(number), "channel": "contact", "candidate": name, "gain": float(gain)}
        for name, own in gains.items()
        for number, gain in enumerate(own)
    ]
    return pa.Table.from_pylist(rows)


def linear_gains(rng, size, measurements=40, samples=100, candidates=20):
    """Held-out gains of candidate columns in linear regression, the first with a true effect of this size."""
    columns = rng.standard_normal((candidates, measurements, 2, samples // 2))  # two halves
    effort = size * columns[0] + rng.standard_normal(columns.shape[1:])
    fitted = np.sum(columns * effort, axis=-1) / np.sum(columns**2, axis=-1)
    left = np.sum((effort - fitted[..., ::-1, None] * columns) ** 2, axis=(-2, -1))
    gains = 0.5 * np.log(np.sum(effort**2, axis=(-2, -1)) / left)
    return gains_table({f"candidate_{number}": own for number, own in enumerate(gains)})


def test_weak_effect_is_named_by_forty_measurements_and_none_without_it():
    rng = np.random.default_rng(1)
    named = [best_effect("contact", linear_gains(rng, 0.0)) for _ in range(60)]
    assert sum(effect is not None for effect in named) <= 2
    assert LEVEL == 0.01
    rng = np.random.default_rng(2)
    named = [best_effect("contact", linear_gains(rng, 0.5)) for _ in range(20)]
    assert [effect.effect if effect else None for effect in named] == ["candidate_0"] * 20
    assert np.mean([effect.share for effect in named]) == pytest.approx(0.2, abs=0.03)  # 0.25 / 1.25
    assert best_effect("contact", linear_gains(rng, 0.5, measurements=4)) is None


def test_equally_good_candidates_are_confused_and_steps_end_without_gain():
    rng = np.random.default_rng(3)
    strong = 0.2 + 0.02 * rng.standard_normal(20)
    first = {"a": strong, "b": strong - 1e-3 * rng.standard_normal(20), "c": strong - 0.1}
    answers = [gains_table(first), gains_table({"c": -0.01 + 0.01 * rng.standard_normal(20)})]
    asked = []

    def screen(question):
        asked.append(question)
        return answers[len(asked) - 1]

    (effect,) = find_common_effects(screen)
    assert {effect.effect, *effect.confused_with} == {"a", "b"}
    assert [question["added"] for question in asked] == [{}, {"contact": [effect.effect]}]
    assert asked[1]["channels"] == ["contact"]


@pytest.mark.slow
def test_common_stiffening_of_half_the_noise_is_detected_in_twelve_recordings(tmp_path):
    speeds = (0.04, 0.08, 0.06)
    (tmp_path / "small").mkdir()
    (tmp_path / "none").mkdir()
    hidden = lambda x, v: 400 * x + 6 * v + 1.2e5 * x**3  # noqa: E731, about 0.5 of the noise at most depth
    assert 0.5 < 1.2e5 * 0.01**3 / NOISE_N * 0.2 < 1.5
    for number in range(12):
        write_presses(tmp_path / "small" / f"r{number}.csv", speeds_m_s=speeds, force_of=hidden, seed=number)
        plain = tmp_path / "none" / f"r{number}.csv"
        write_presses(plain, speeds_m_s=speeds, cubic=0.0, seed=100 + number)
    small = palpate.batch(tmp_path / "small", out=tmp_path / "out", pool=True, workers=2)
    (effect, *_) = small.common_effects
    assert "cubic_stiffness" in {effect.effect, *effect.confused_with}
    assert effect.effect in (tmp_path / "out" / "index.html").read_text()
    none = palpate.batch(tmp_path / "none", out=tmp_path / "none_out", pool=True, workers=2)
    assert none.common_effects == ()
    out = ("--out", tmp_path / "none_out", "--workers", 1)
    said = {more: run("batch", tmp_path / "none", *out, *more).stdout for more in [(), ("--pool",)]}
    assert "--pool: the pooled data show no missing effect" in said["--pool",]
    assert "--pool" not in said[()]
