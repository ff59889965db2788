"""Work functions that probe a simulated object, and estimate its parameters or diagnose its model."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from hashlib import sha256
from typing import Any

import numpy as np

from palpate.control.loop.task import Phase
from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.base_model import ModelContext
from palpate.estimation.channel import ChannelData
from palpate.estimation.contact_estimators import CONTACT_ESTIMATORS
from palpate.estimation.data.tick_channels import contact_channels, joint_channels
from palpate.estimation.effects.contact_geometry import ContactOffset
from palpate.estimation.estimate_channel import estimate_channel, fitting_rows
from palpate.estimation.estimator import ContactEstimator, Estimator
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.estimators.ransac import Ransac
from palpate.estimation.fit.samples import fit_samples, slopes_of
from palpate.estimation.model import Model, Regression
from palpate.estimation.models import MODELS
from palpate.estimation.statistics.uncertainty import cramer_rao
from palpate.estimation.study.channels import CONTACT_MODEL
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import validate
from palpate.robot_io.session import Samples
from palpate.robot_io.types import FloatArray
from palpate.runs.hidden_effects import SURFACE, hide, truth_of
from palpate.runs.probing import probe_in_memory
from palpate.runs.robots import find_robot
from palpate.sim_backend.engines import EngineName
from palpate.sim_backend.scenario import Scenario, load_scenario
from palpate.study import Study, arm_from_urdf
from palpate.sweep.case import Row

NOTHING = "none"  # no hidden effects


def estimate(parameters: Mapping[str, Any], seed: int) -> list[Row]:
    """Probe once, and return one row per estimator and draw of the force noise.

    Args:
        parameters: parameters of the case; see `palpate.sweep.grid` for the keys.
        seed: seed of all random numbers.

    Raises:
        PalpateError: the object could not be probed.
    """
    ticks, scenario = probe(parameters, seed)
    channel = _contact_channel(ticks)
    model = MODELS[parameters["model"]]().build(ModelContext(surface_found=True))
    truth = truth_of(scenario)
    # By speed: the largest force during loading, and the time during which it exceeded the limit.
    loading = (ticks["phase"] == Phase.LOADING) | (ticks["phase"] == Phase.HOLD)
    runs: Sequence[int] = np.unique(ticks["run"][loading]).tolist()
    forces = [ticks["force_n"][loading & (ticks["run"] == run)] for run in runs]
    limit_n = float(np.nanmax(ticks["desired_force_n"][loading]))
    reached = {
        "peak_n": [float(force.max()) for force in forces],
        "over_limit_ms": [float(np.count_nonzero(force > 1.05 * limit_n)) for force in forces],
    }
    common = _conditions(parameters) | reached | {f"true {name}": truth[name] for name in truth}
    # Standard deviation of additional noise, relative to the force.
    rows, share = [], parameters["noise_percent"] / 100
    for draw in range(parameters["draws"]):
        rng = np.random.default_rng([scenario.seed, draw])
        factors = 1.0 + share * rng.standard_normal(len(channel)) if share else np.ones(len(channel))
        drawn = replace(channel, effort=channel.effort * factors)
        common |= {"draw": draw} | _bounds(drawn, model, truth, scenario, share)
        rows += [common | _estimate_with(drawn, model, spec, seed) for spec in parameters["estimators"]]
    return rows


def _bounds(
    channel: ChannelData, model: Model, truth: Mapping[str, float], scenario: Scenario, share: float
) -> Row:
    """Return Cramer-Rao bounds for known noise and unknown surface; empty for laws without a bound."""
    names = [*model.gains, *model.inner]
    surface = channel.surface
    if surface is None or not all(name in truth or name.startswith("contact_offset") for name in names):
        return {}
    known = dict(truth) | {"contact_offset.offset": truth[SURFACE] - surface.position_m}
    at, rows, sensor = {name: known[name] for name in names}, fitting_rows(channel), scenario.sensors.force
    force_n = model.predict(channel, at)[rows]
    variance = sensor.noise_std_n**2 + sensor.resolution_n**2 / 12 + (share * force_n) ** 2
    spread = cramer_rao(slopes_of(model, channel, at)[rows], np.sqrt(variance))
    return {f"bound {name}": float(std) for name, std in zip(names, spread, strict=True) if name in truth}


def _estimate_with(channel: ChannelData, model: Model, spec: str | Mapping[str, Any], seed: int) -> Row:
    label, estimator = make_estimator(spec)
    row: Row = {"estimator": label, "problem": ""}
    rng = np.random.default_rng(seed)
    try:
        if isinstance(estimator, ContactEstimator):
            # Depth, speed and force in contact, for methods that need a known surface: the surface of least
            # squares.
            rows = fitting_rows(channel)
            surface_m = fit_samples(model, channel, rows).parameters[f"{ContactOffset.name}.offset"]
            samples = channel.position[rows] - surface_m, channel.velocity[rows], channel.effort[rows]
            law = estimator.fit(*samples, rng=rng)  # these estimators return no intervals
            if model.name == "hunt_crossley":
                names = (f"{model.name}.{name}" for name in "kbn")
                return row | dict(zip(names, law[:3], strict=True))
            return row | {"stiffness.k": law.stiffness, "damping.c": law.damping}
        estimate = estimate_channel(channel, model, estimator, rng=rng)
    except (InputError, np.linalg.LinAlgError) as error:
        return row | {"problem": str(error)}
    for parameter in estimate.parameters:
        row |= {
            parameter.name: parameter.value,
            f"low {parameter.name}": parameter.interval[0],
            f"high {parameter.name}": parameter.interval[1],
        }
    return row | {"inlier_share": float(np.mean(estimate.inliers)), "rmse_n": estimate.rmse}


def diagnose(parameters: Mapping[str, Any], seed: int) -> list[Row]:
    """Probe and diagnose once, and return one row per diagnosed channel.

    The parameter `channels` selects channels; by default all are diagnosed.

    Args:
        parameters: parameters of the case; see `palpate.sweep.grid` for the keys.
        seed: seed of all random numbers.
    """
    samples, scenario = probe(parameters, seed)
    robot = find_robot(parameters["robot"])
    every = [*contact_channels(samples, tared=False), *joint_channels(samples)]
    chosen = parameters.get("channels", [channel.name for channel in every])
    channels = [channel for channel in every if channel.name in chosen]
    # With the default model the joints are diagnosed too, each with its own model.
    model = None if parameters["model"] == CONTACT_MODEL else parameters["model"]
    study = Study(channels, model, arm=arm_from_urdf(robot.urdf_path, robot.tip_frame))
    common = _conditions(parameters) | {"truth": ", ".join(law.name for law in scenario.hidden) or NOTHING}
    common |= {"truth_channel": ", ".join(" ".join(law.channels) for law in scenario.hidden)}
    return [
        common
        | {"channel": channel.channel, "verdict": channel.verdict.value, "complete": channel.complete}
        | {"accepted": ", ".join(entry.effect for entry in channel.accepted)}
        for channel in study.diagnose().channels
    ]


def ticks(parameters: Mapping[str, Any], seed: int) -> list[Row]:
    """Probe once, and return one row per tick of a run, for figures over time.

    Args:
        parameters: parameters of the case; see `palpate.sweep.grid` for the keys.
        seed: seed of all random numbers.
    """
    samples, _ = probe(parameters, seed)
    contact = _contact_channel(samples)
    names = ("time_s", "run", "phase", "force_n", "desired_force_n")
    columns: dict[str, Any] = {name: samples[name] for name in names}
    depth = np.full(len(samples), np.nan)
    depth[np.searchsorted(samples["force_at_s"], contact.time_s)] = contact.position
    columns["depth_m"] = depth
    for joint in range(samples.vector("torque_measured_nm").shape[1]):
        for what in ("measured", "commanded"):
            columns[f"torque_{what}_{joint + 1}_nm"] = samples.vector(f"torque_{what}_nm")[:, joint]
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


def probe(parameters: Mapping[str, Any], seed: int) -> tuple[Samples, Scenario]:
    """Return the ticks of a probing run, and its simulated world.

    The parameter `engine` replaces the scenario's physics engine; world and noise stay the same.

    Args:
        parameters: parameters of the case; see `palpate.sweep.grid` for the keys.
        seed: seed of all random numbers.

    Raises:
        PalpateError: the object could not be probed, or the parameters do not fit each other.
    """
    keys = ("robot", "scenario", "law", "plan", "hidden", "noise_std_n")
    text = json.dumps({key: parameters[key] for key in keys}, sort_keys=True)
    return _probe(text, seed, parameters.get("engine"))


@lru_cache(maxsize=2)
def _probe(text: str, seed: int, engine: EngineName | None) -> tuple[Samples, Scenario]:
    """Probe once; the last run is cached, because many cases of a worker evaluate the same run.

    The world's seed is derived from all parameters. With a common seed, all objects would have the same noise
    and the same errors.
    """
    parameters = json.loads(text)
    scenario = world(parameters, int(sha256(f"{seed} {text}".encode()).hexdigest()[:12], 16))
    if engine is not None:
        scenario = scenario.with_engine(engine)
    plan = validate(ProbingPlan, parameters["plan"])
    return probe_in_memory(find_robot(parameters["robot"]), scenario, plan), scenario


def world(parameters: Mapping[str, Any], seed: int) -> Scenario:
    """Make the simulated world of a case; raise `InputError` if the parameters conflict.

    Args:
        parameters: parameters of the case.
        seed: seed of the world's noise.
    """
    data = load_scenario(parameters["scenario"]).model_dump()
    data["object"]["law"] = parameters["law"]
    data["sensors"]["force"]["noise_std_n"] = parameters["noise_std_n"]
    scenario = validate(Scenario, data | {"seed": seed})
    hidden = parameters["hidden"]
    if hidden == NOTHING:
        return scenario
    if isinstance(hidden, str):
        return hide(scenario, hidden)
    return validate(Scenario, data | {"seed": seed, "hidden": hidden})


def _contact_channel(samples: Samples) -> ChannelData:
    """Return the contact with its force in free air subtracted; raise `InputError` if nothing was touched."""
    channels = contact_channels(samples, tared=True)
    if not channels:
        raise InputError("nothing was touched, or only for too short a time")
    return channels[0]


def make_estimator(spec: str | Mapping[str, Any]) -> tuple[str, Estimator | ContactEstimator]:
    """Make an estimator from its name, or from a mapping with `name`, settings and perhaps `label`.

    Args:
        spec: name of the estimator, or mapping.

    Raises:
        InputError: the estimator does not exist or does not accept these settings.
    """
    given = {"name": spec} if isinstance(spec, str) else spec
    settings = {key: value for key, value in given.items() if key not in {"name", "label"}}
    name = given.get("name", "")
    try:
        made = CONTACT_ESTIMATORS[name] if name in CONTACT_ESTIMATORS else ESTIMATORS[name]
        words = ", ".join(f"{key} {value:g}" for key, value in settings.items())
        return given.get("label") or (f"{name} ({words})" if words else name), made(**settings)
    except (TypeError, ValueError) as error:
        raise InputError(f"estimator '{name}': {error}") from error


def _conditions(parameters: Mapping[str, Any]) -> Row:
    hidden = parameters["hidden"]
    law = {f"law {key}": value for key, value in parameters["law"].items() if key != "name"}
    return law | {
        "law": parameters["law"]["name"],
        "speeds_mm_s": ", ".join(f"{1e3 * speed:g}" for speed in parameters["plan"]["speeds_m_s"]),
        "noise_std_n": parameters["noise_std_n"],
        "noise_percent": parameters["noise_percent"],
        "hidden": hidden if isinstance(hidden, str) else ", ".join(entry["effect"] for entry in hidden),
    }


def ransac_errors(parameters: Mapping[str, Any], seed: int) -> list[Row]:
    """Return one row of root mean square errors of k and c relative to their bounds, from many noise draws.

    Motion and surface are known exactly, so that errors depend on the settings only. A share of
    `outliers_percent` of the samples has errors up to the largest force; the bound excludes these samples.

    Args:
        parameters: parameters of the case; see `palpate.sweep.grid` for the keys.
        seed: seed of all random numbers.
    """
    ticks, scenario = probe(parameters, seed)
    truth, channel = truth_of(scenario), _contact_channel(ticks)
    rows = fitting_rows(channel)
    surface_m = channel.surface.position_m - truth[SURFACE] if channel.surface else 0.0
    columns = np.column_stack([channel.position[rows] + surface_m, channel.velocity[rows]])
    gains = np.array([truth["stiffness.k"], truth["damping.c"]])
    force_n = columns @ gains
    sigma_n = np.hypot(parameters["noise_std_n"], parameters["noise_percent"] / 100 * force_n)
    bound = cramer_rao(columns, sigma_n)
    ransac = Ransac(**parameters["settings"])
    errors: list[FloatArray] = []
    shares: list[float] = []
    for draw in range(parameters["draws"]):
        rng = np.random.default_rng([seed, draw])
        noisy_n = force_n + sigma_n * rng.standard_normal(len(force_n))
        wrong = rng.random(len(force_n)) < parameters["outliers_percent"] / 100
        noisy_n[wrong] += rng.uniform(-1, 1, np.count_nonzero(wrong)) * force_n.max()
        problem = Regression(columns, noisy_n, ("k", "c"), ("N/m", "N s/m"), run=channel.run[rows])
        try:
            fit = ransac.fit(problem, rng=rng)
        except InputError:  # too few samples agree
            errors.append(gains)
            shares.append(0.0)
            continue
        errors.append(np.array([fit["k"].value, fit["c"].value]) - gains)
        shares.append(float(np.mean(fit.inliers)))
    k, c = np.sqrt(np.mean(np.square(errors), axis=0)) / bound
    conditions = {key: parameters[key] for key in ("noise_percent", "outliers_percent")}
    result = {"k_over_bound": float(k), "c_over_bound": float(c), "inlier_share": float(np.mean(shares))}
    return [conditions | parameters["settings"] | result]
