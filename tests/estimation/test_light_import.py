"""Estimation needs numpy, scipy, pyarrow and pydantic only, and imports the slow ones when it uses them."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PARTS = "channel effects models estimators fit.fit_result diagnosis study"
MODULES = tuple(f"palpate.estimation.{name}" for name in PARTS.split())
SLOW = ("pyarrow", *(f"scipy.{name}" for name in ("linalg", "optimize", "signal", "sparse", "stats")))

# Own packages, what may be installed, and what these bring with them.
ALLOWED = (
    *("palpate", "numpy", "scipy", "pyarrow", "pydantic"),
    *("pydantic_core", "annotated_types", "typing_extensions", "typing_inspection"),
)
BLOCK = f"""
import importlib, sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in sys.stdlib_module_names and top not in {ALLOWED} and not top.startswith("_"):
            raise ModuleNotFoundError(f"{{name}} is not installed", name=name)

sys.path.insert(0, {str(ROOT)!r})
sys.meta_path.insert(0, Blocker())
"""
IMPORT = f"""
for name in {MODULES}:
    importlib.import_module(name)
assert not set({SLOW}) & set(sys.modules), set({SLOW}) & set(sys.modules)
"""
FIT = """
import numpy as np
from palpate.estimation.study import ModelStudy

rng, t = np.random.default_rng(1), np.arange(0.0, 1.0, 0.005)
x, v, run = (np.concatenate(parts) for parts in zip(*[
    (0.003 * np.sin(w * t), 0.003 * w * np.cos(w * t), np.full(len(t), n)) for n, w in enumerate((8, 11, 15))
]))
press = {"time_s": np.tile(t, 3), "displacement_m": x, "velocity_m_s": v, "run": run}
press["force_N"] = np.where(x > 0, 400 * x + 3 * v, 0).clip(0) + rng.normal(0, 0.01, len(x))
study = ModelStudy(press, "kelvin_voigt")
study.fit("contact").parameters["stiffness.k"]
print(study.fit("contact").values["stiffness.k"])
"""


def run(code):
    """Run code where nothing else is installed, and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", BLOCK + code], capture_output=True, text=True, check=False, cwd="/"
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_table_is_fitted_without_optional_packages_and_slow_ones_are_imported_late():
    assert 390 < float(run(IMPORT + FIT)) < 410


def test_study_imports_neither_simulator_nor_exporters():
    code = "import sys, palpate.study; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    late = ("palpate.sim_backend", "palpate.export", "palpate.runs", "plotly", "pyarrow")
    assert [name for name in done.stdout.split() if name.startswith(late)] == []
