"""Estimate the object at each target, in separate processes while the arm continues.

After every run, a first estimate is made with intervals: spring and damper or Hunt-Crossley, whichever has
the smaller error. After the last run of a target, a diagnosis follows, which may add effects and states
whether the model is complete.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from palpate.common.worker_process import start_worker
from palpate.control.loop.tick_record import tick_stream
from palpate.estimation.channel import ChannelData
from palpate.estimation.data.contact import find_contacts
from palpate.estimation.data.tick_channels import contact_channels
from palpate.estimation.diagnosis.result import ParameterValue
from palpate.estimation.workers import end_with_parent
from palpate.export.scenario import FittedChannel, export_scenario
from palpate.robot_io.errors import InputError, error_text
from palpate.robot_io.link.messages import MOST_TEXT, EstimatedParameter, ObjectEstimate
from palpate.robot_io.session import Samples, Stream
from palpate.robot_io.types import FloatArray
from palpate.sim_backend.scenario import Scenario
from palpate.study import Study
from palpate.teleop.virtual_object import terms_of

_MODELS = ("kelvin_voigt", "hunt_crossley")
_ESTIMATORS = "weighted,lsq"
EstimateFunction = Callable[[Samples, int], ObjectEstimate]
_NICE = 5  # niceness of the diagnosis, below the control loop
_ENOUGH = 1.3  # multiple of the noise; below it no second law is fitted


_SAMPLED = {
    *("time_s", "run", "phase", "joint_position_rad", "force_n", "tip_position_world_m"),
    *("press_direction_world", "encoder_at_s", "force_at_s", "encoder_status", "force_status"),
}


def sample_stream(joint_count: int) -> Stream:
    """Return the columns of a tick that estimation needs, in the order of the stream "tick"."""
    columns = tick_stream(joint_count).columns
    return Stream("sample", tuple(column for column in columns if column.name in _SAMPLED))


def estimate_object(samples: Samples, target: int) -> ObjectEstimate:
    """Fit two contact laws to a target's runs so far, and return the better one.

    Args:
        samples: samples of one target.
        target: number of the target.

    Raises:
        InputError: nothing was touched, or there are too few contact samples.
    """
    return _better(_contact(samples), target)[1]


def diagnose_object(samples: Samples, target: int) -> ObjectEstimate:
    """Fit and diagnose a target: the better law with accepted effects, and the verdict.

    The verdict names accepted effects that the simulator cannot render.

    Args:
        samples: samples of one target.
        target: number of the target.

    Raises:
        InputError: as for `estimate_object`.
    """
    contact = _contact(samples)
    model, made = _better(contact, target)
    study = Study(contact.channel, model)
    (answer,) = study.diagnose(apply=True).channels
    verdict, words = str(answer.verdict), answer.reason
    try:
        (revision,) = study.to_export()
        made = _estimate(contact, target, revision.parameters, revision.rmse)
    except InputError as error:
        words = f"part of the model cannot be rendered ({error}); {words}"
    return replace(made, verdict=verdict, words=words[:MOST_TEXT])


class ObjectEstimator:
    """Distributes work to two processes, one for fits and one for diagnoses; the owner polls for results.

    Each process handles one target at a time. Of waiting samples, only the newest of each target are kept.
    `diagnose` enables diagnoses.
    """

    def __init__(self, *, diagnose: bool) -> None:
        functions = [(estimate_object, 0), *([(diagnose_object, _NICE)] if diagnose else [])]
        self._workers = [_EstimatorProcess(function, nice) for function, nice in functions]

    @property
    def busy(self) -> bool:
        """Whether an answer is pending."""
        return any(worker.busy for worker in self._workers)

    def request(self, samples: Samples, target: int, *, last: bool) -> None:
        """Request an estimate for a target's samples, and after the last run a diagnosis."""
        for worker in self._workers[: 2 if last else 1]:
            worker.take(samples, target)

    def answers(self) -> list[ObjectEstimate | str]:
        """Return the estimates since the last call, or the reasons why there is none."""
        return [answer for worker in self._workers for answer in worker.answers()]

    def close(self) -> None:
        """Kill the processes."""
        for worker in self._workers:
            worker.process.kill()
            worker.process.join()


class _EstimatorProcess:
    """A process for one kind of estimate. It gets new work only when idle, so no pipe fills up."""

    def __init__(self, estimate: EstimateFunction, nice: int) -> None:
        self.process, self._pipe = start_worker(_serve, estimate, nice)
        self._waiting: dict[int, Samples] = {}
        self._ready = False

    @property
    def busy(self) -> bool:
        return self.process.is_alive() and (bool(self._waiting) or not self._ready)

    def take(self, samples: Samples, target: int) -> None:
        self._waiting[target] = samples

    def answers(self) -> list[ObjectEstimate | str]:
        results: list[ObjectEstimate | str] = []
        try:
            while self._pipe.poll():
                answer, self._ready = self._pipe.recv(), True
                results += [] if answer is None else [answer]
            if self._ready and self._waiting:
                target = next(iter(self._waiting))
                self._pipe.send((self._waiting.pop(target), target))
                self._ready = False
        except (EOFError, OSError):
            if self._waiting:
                self._waiting.clear()
                results.append("no estimate: the estimating process has ended")
        return results


def _serve(pipe: Connection, estimate: EstimateFunction, nice: int) -> None:
    """Estimate all received samples at low priority; exit with the parent."""
    os.nice(nice)
    end_with_parent()
    pipe.send(None)  # ready: all modules are imported
    while True:
        try:
            pipe.send(estimate(*pipe.recv()))
        except EOFError:
            return
        except InputError as error:
            pipe.send(f"no estimate: {error}")
        except Exception as error:  # an error must not end the estimates of other targets
            pipe.send(f"no estimate: {error_text(error)}")


class _Contact(NamedTuple):
    """Measurements at one target."""

    channel: ChannelData
    tip_world_m: FloatArray  # mean of the tip in contact, shape (3,) [m]
    direction_world: FloatArray  # unit vector into the object, shape (3,)
    noise_n: float  # noise of the sensor in free air [N]
    measured_s: float  # time of the last sample [s]


def _contact(samples: Samples) -> _Contact:
    channels = contact_channels(samples, tared=True)
    if not channels:
        raise InputError("nothing was touched at this target")
    contacts = find_contacts(samples["force_n"], samples["run"], samples["phase"])
    touched = np.concatenate([contact.rows for contact in contacts])
    tip_m = samples["tip_position_world_m"][touched].mean(axis=0)
    direction = samples["press_direction_world"][touched[-1]]
    noise_n = float(np.mean([contact.noise_n for contact in contacts]))
    return _Contact(channels[-1], tip_m, direction, noise_n, float(samples["force_at_s"].max()))


def _better(contact: _Contact, target: int) -> tuple[str, ObjectEstimate]:
    """Return the contact law with the smaller error, by name, with its estimate.

    The second law is not tried if the first leaves only noise.
    """
    better: list[tuple[str, ObjectEstimate]] = []
    for model in _MODELS:
        try:
            (estimates,) = Study(contact.channel, model).estimate(_ESTIMATORS)
            parameters = {p.name: ParameterValue.of(p) for p in estimates.best.parameters}
            better.append((model, _estimate(contact, target, parameters, estimates.best.rmse)))
        except InputError as error:
            failure = error
        if better and better[0][1].rmse_n <= _ENOUGH * contact.noise_n:
            break
    if not better:
        raise failure
    return min(better, key=lambda pair: pair[1].rmse_n)


def _estimate(
    contact: _Contact, target: int, parameters: Mapping[str, ParameterValue], rmse_n: float
) -> ObjectEstimate:
    """Convert a fitted model to a message.

    Raises:
        InputError: the simulator, which renders the laws, has no such law or effect.
    """
    values = {name: parameter.value for name, parameter in parameters.items()}
    fitted = FittedChannel(contact.channel.name, values, contact.channel.surface, 0)
    export = export_scenario(Scenario(), [fitted], "")
    if export.left_out:
        raise InputError(export.left_out[0])
    estimated = (EstimatedParameter(name, p.unit, p.value, *p.interval) for name, p in parameters.items())
    tip_m, direction = contact.tip_world_m, contact.direction_world
    # Sign convention of `export_scenario`, for any direction.
    along_m = -export.scenario.object.surface_height_m
    surface_m = tip_m + (along_m - tip_m @ direction) * direction
    return ObjectEstimate(
        revision=0,
        target=target,
        surface_world_m=tuple(surface_m.tolist()),
        direction_world=tuple(direction.tolist()),
        model=terms_of(export.scenario),
        parameters=tuple(estimated),
        verdict="",
        words="",
        rmse_n=rmse_n,
        noise_n=contact.noise_n,
        runs=len(contact.channel.runs),
        measured_s=contact.measured_s,
    )
