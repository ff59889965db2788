"""One study of one measurement: compare, diagnose, extend, and export models."""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.common.failures import with_python_wording
from palpate.common.files import derived_folder, existing_data, existing_file, write_text
from palpate.common.user_effects import LIMIT_S, guarded, load_user_effects, place_of, try_effect, user_code
from palpate.control.arm.rigid_body import RigidBody
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.column_names import PROXIES, si_unit
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.design.next_experiment import NextProbe
from palpate.estimation.diagnosis import ChannelDiagnosis
from palpate.estimation.effect import Effect
from palpate.estimation.study import Arm, ModelStudy, Revision, StudyChannel
from palpate.estimation.study.fitting import Judge, Progress, diagnose
from palpate.estimation.study.results import StudyDiagnosis
from palpate.render.build import view_of
from palpate.render.notebook import PageAddress, notebook_progress
from palpate.robot_io.errors import InputError, one_line
from palpate.robot_io.extras import missing_package
from palpate.robot_io.files.file_model import read_text
from palpate.robot_io.files.urdf_text import last_link, parse_urdf

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from palpate.export.scenario import Export
    from palpate.export.simulator import WrittenModels
    from palpate.export.target_terms import FittedJoint, SimulatorFormat
    from palpate.sim_backend.scenario import Scenario

TIP_FRAME = "tip"


@with_python_wording
class Study(ModelStudy):
    """Compare models with a measurement, find missing effects, and add or remove them.

    Revisions and diagnosis of a file are saved in the folder of its name, which the commands use as well.

    >>> import numpy as np
    >>> rng, t = np.random.default_rng(1), np.arange(0, 1, 0.002)
    >>> runs = []
    >>> for run, speed in enumerate((6.0, 9.0, 12.0, 15.0)):  # four presses at different speeds
    ...     x = 0.004 * (1 - np.cos(speed * t)) - 0.001
    ...     v = 0.004 * speed * np.sin(speed * t)
    ...     force = np.where(x > 0, 400 * x + 3 * v + 3e6 * x**3, 0).clip(0) + rng.normal(0, 0.02, len(t))
    ...     runs.append({"time_s": t, "displacement_m": x, "force_N": force, "run": np.full(len(t), run)})
    >>> press = {name: np.concatenate([run[name] for run in runs]) for name in runs[0]}
    >>> study = Study(press, model="kelvin_voigt")
    >>> study.channels
    (contact: kelvin_voigt, 4 runs, 2000 samples, ...,)
    >>> study.compare()["contact"].lack_of_fit > 5
    True
    >>> found = study.diagnose().channels[0]
    >>> found.verdict.value, [entry.effect for entry in found.accepted]
    ('missing', ['cubic_stiffness'])
    >>> change = study.add("cubic_stiffness")
    >>> change.result.stages[1].parameters["cubic_stiffness.k3"].interval  # N/m^3, 95 %
    (2..., 3...)
    >>> study.remove("cubic_stiffness").revisions[0].effects
    []
    >>> [revision.number for revision in study.revisions]
    [0, 1, 2]

    Args:
        data: path of a session or data file, or of a folder of them; a list of data files; a table (pandas,
            pyarrow, or a dict of arrays); or channels.
        model: base model; None to choose one for each channel.
        columns: roles of a table's columns; see `palpate.estimation.data.import_options.ImportOptions` for
            this and the next six.
        units: units by quantity, such as {"force": "mN"}.
        where: text by column; other rows are dropped.
        context: further numeric columns to keep.
        fresh: whether each run pressed an object that was never pressed before; otherwise the data decide.
        runs: number of presses in a recording; None to detect it.
        table: sheet, or line of the header, of a table other than the file's longest.
        arm: arm of the channels: an `Arm`, or the path of a URDF whose tip is the link "tip", or else the
            last link.
        effects: your own effects: objects, or "my_effects.py:MyEffect".
        folder: folder of revisions and diagnosis; None for the usual one.
        keep: False to keep them in memory only.
        held_out: numbers of runs excluded from fitting, on which alone `compare` and `add` score models;
            `diagnose` and `estimate` ignore them. If empty, each run is predicted from a fit to the others.

    Raises:
        InputError: the data cannot be used, or the model does not apply to them.
    """

    def __init__(
        self,
        data: Any,  # noqa: ANN401, whatever a user has
        model: str | None = None,
        *,
        columns: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        where: Mapping[str, str] | None = None,
        context: Sequence[str] = (),
        fresh: bool = False,
        runs: int | None = None,
        table: str = "",
        arm: Arm | Path | str | None = None,
        effects: Sequence[str | Effect] = (),
        folder: Path | str | None = None,
        keep: bool = True,
        held_out: Sequence[int] = (),
    ) -> None:
        if isinstance(effects, str) or not isinstance(effects, Sequence):
            raise InputError(f"effects={effects!r}: give a list, such as ['my_effects.py:MyEffect']")
        for entry in effects:
            if not isinstance(entry, str | Effect):
                raise InputError(f"effects: {entry!r} is neither an effect nor 'FILE.py:CLASS'")
        if not isinstance(arm, Arm | Path | str | None):
            raise InputError(f"arm={arm!r}: give the path of a URDF, or an Arm")
        own = load_user_effects([effect for effect in effects if isinstance(effect, str)])
        objects = [effect for effect in effects if isinstance(effect, Effect)]
        own |= {f"{type(e).__module__}:{type(e).__qualname__}": guarded(e) for e in objects}
        place = None if folder is None else _path(folder, "folder")
        if isinstance(data, str | Path):
            data = existing_data(Path(data))
            place = (place or derived_folder(data)) if keep else None
        signals: Any = tuple(context) if isinstance(context, list) else context
        options = ImportOptions(columns or {}, units or {}, where or {}, signals, fresh, runs, table)
        arm = arm_from_urdf(Path(arm)) if isinstance(arm, str | Path) else arm
        super().__init__(data, model, options=options, arm=arm, effects=own, folder=place, held_out=held_out)
        for text, effect in own.items():  # refuse one that fails on a channel, or changes nothing on any
            try:
                with user_code(f"effect '{effect.name}'", LIMIT_S):
                    acts = {channel.name: try_effect(effect, channel.data) for channel in self.channels}
            except InputError as error:
                raise InputError(f"--effect {text}: {error}") from error
            idle = ", ".join(name for name, does in acts.items() if does is False)
            if idle and not any(acts.values()):
                spot = place_of(type(effect), "columns")
                raise InputError(
                    f"--effect {text}: its columns are zero throughout {idle}, so nothing can be fitted{spot}"
                )

    def diagnose(
        self,
        channel: str | None = None,
        *,
        apply: bool = False,
        plan: bool = True,
        progress: Progress | None = None,
        judge: Judge = diagnose,
    ) -> StudyDiagnosis:
        """See `ModelStudy.diagnose`; without `progress`, a notebook shows a bar."""
        bar = progress or notebook_progress()
        try:
            return super().diagnose(channel, apply=apply, plan=plan, progress=bar, judge=judge)
        finally:
            if progress is None:
                bar("", 1.0)

    def workbench(self, port: int = 0, *, browser: bool = True) -> PageAddress:
        """Open the workbench on this study; it runs until this program or notebook ends.

        Page and program share the study, including all revisions.

        Args:
            port: port on this machine; 0 for any free port.
            browser: whether to open the page in a browser.

        Returns:
            Address of the page; a notebook shows it as a link.

        Raises:
            InputError: the port is taken, a page is open already, or the workbench is not installed.
        """
        # Imported here because the page imports this class and is slow to import.
        try:
            server = import_module("palpate.workbench.server")
        except ModuleNotFoundError as error:
            raise InputError(missing_package(error.name) or str(error)) from error
        address: PageAddress = server.open_page(self, port, browser=browser)
        return address

    def plot(self, channel: str | None = None) -> "go.Figure":
        """Draw one channel: the error of each stage, and curves of measurement and models.

        Args:
            channel: name of the channel; None for the only one.

        Raises:
            InputError: there is no such channel, or there are several.
        """
        from palpate.render.report import figure  # noqa: PLC0415, plotly takes half a second to import

        return figure(view_of(self, [self._newest_result(self._current(self.channel(channel)))]).channels[0])

    def report(self, path: Path | str, commands: Sequence[str] = ()) -> Path:
        """Write the report as one HTML file.

        Args:
            path: the file, replaced if it exists.
            commands: commands that repeat the results, listed in the report.

        Raises:
            InputError: the file cannot be written.
        """
        from palpate.render.report import document  # noqa: PLC0415, as above

        place = _path(path, "report")
        write_text(place, document(view_of(self, commands=commands)))
        return place

    def export(self, path: Path | str, revisions: int | Sequence[int] = ()) -> "Export":
        """Write the fitted models as a simulated world.

        Args:
            path: the scenario file, replaced if it exists.
            revisions: one or several revision numbers; by default each channel's newest revision of these
                data, or the contact's base model if it has no revision.

        Raises:
            InputError: a revision is of other data, several are of one channel, there is nothing to write, or
                the file cannot be written.
        """
        from palpate.export.scenario import FittedChannel, export_scenario  # noqa: PLC0415, with the simulator

        place, chosen = _path(path, "scenario"), self.to_export(_numbers(revisions))
        joints = sum(channel.name.startswith("joint_") for channel in self.source.channels)
        fitted = []
        for revision in chosen:
            values = {name: parameter.value for name, parameter in revision.parameters.items()}
            surface = self.channel_of(revision).data.surface
            fitted.append(FittedChannel(revision.channel, values, surface, joints))
        _refuse_other_units([self.channel_of(revision).measured for revision in chosen])
        models = (f"{item.channel} {' + '.join([item.model, *item.effects])}" for item in chosen)
        description = f"as measured in {self.source.name}: {'; '.join(models)}"
        if not any(each.is_contact for each in fitted):
            description += "; the object was not measured"
        made = export_scenario(self._base_world(), fitted, description)
        notes = "".join(f"# {one_line(note)}\n" for note in self.reading)
        write_text(place, notes + made.scenario.to_yaml())
        return made

    def export_feedforward(self, path: Path | str, revisions: int | Sequence[int] = ()) -> "WrittenModels":
        """Write the joints' feedforward as a table (YAML), with functions in Python and C beside it.

        Args:
            path: the table, replaced if it exists; the functions have its name and end in .py and .c.
            revisions: one or several revision numbers; by default each joint's newest revision of these data,
                or its base model if it has no revision.

        Returns:
            The written files, with what is in them and what was left out.

        Raises:
            InputError: no channel is a joint, a revision is not of a joint or is of other data, several are
                of one joint, or a file cannot be written.
        """
        from palpate.export.feedforward import write_feedforward  # noqa: PLC0415, only here

        place = _path(path, "feedforward")
        fitted, failures = self._fitted_joints(revisions, "a feedforward")
        return write_feedforward(place, fitted, failures, self.source.name, self.reading)

    def export_simulator(
        self,
        path: Path | str,
        target: "SimulatorFormat | str",
        patch: Path | str | None = None,
        revisions: int | Sequence[int] = (),
        servo_gain_nm_rad: float | None = None,
    ) -> "WrittenModels":
        """Write friction, rotor, spring, payload and gravity of joints for another simulator.

        Args:
            path: the file, replaced if it exists; it must not be `patch`. A BAM file describes one servo; for
                several joints, each gets its own file with the joint in its name.
            target: "mjcf", "urdf", "isaaclab" or "bam".
            patch: the user's file whose values are replaced in the output; it is only read. Required for
                MJCF; for URDF the default is the arm's; for BAM, a parameter file of the motor.
            revisions: as for `export_feedforward`.
            servo_gain_nm_rad: torque per goal error of the servos [N m/rad], required if no effort was
                measured; the gain `kp` of a <position> actuator in an MJCF.

        Raises:
            InputError: as for `export_feedforward`, the target is unknown, the gain is missing, superfluous
                or not above 0, or `patch` is missing, not readable or lacks a joint.
        """
        from palpate.export.simulator import write_simulator  # noqa: PLC0415, only here
        from palpate.export.target_terms import SimulatorFormat  # noqa: PLC0415, likewise

        if target not in set(SimulatorFormat):
            raise InputError(f"target {target!r}: no such simulator. Valid: {', '.join(SimulatorFormat)}")
        place, target = _path(path, "output"), SimulatorFormat(target)
        base = None if patch is None else existing_file(_path(patch, "patch"), "patch")
        fitted, failures = self._fitted_joints(revisions, target.value)
        _refuse_other_units([joint.fit.data for joint in fitted], is_gain_known=servo_gain_nm_rad is not None)
        if servo_gain_nm_rad is not None:
            if not (isfinite(servo_gain_nm_rad) and servo_gain_nm_rad > 0.0):
                raise InputError(f"--servo-gain {servo_gain_nm_rad:g} N m/rad: must be above 0")
            for joint in fitted:
                if joint.kind is not ChannelKind.SERVO:
                    raise InputError(
                        f"--servo-gain {servo_gain_nm_rad:g}: the effort of {joint.name} was measured; omit "
                        "this option"
                    )
            fitted = [replace(joint, servo_gain_nm_rad=servo_gain_nm_rad) for joint in fitted]
        return write_simulator(
            fitted,
            target,
            place,
            self.source.arm,
            patch=base,
            failures=failures,
            source=self.source.name,
            notes=self.reading,
        )

    def _fitted_joints(
        self, revisions: int | Sequence[int], what: str
    ) -> tuple[list["FittedJoint"], list[str]]:
        """Return joints with their newest or chosen models, and reasons for those left out."""
        numbers = _numbers(revisions)
        joints = {item.name: item for item in self.channels if item.kind is not ChannelKind.CONTACT}
        if not joints:
            raise InputError(
                f"{self._file}: no channel is a joint, and {what} exports joints only. Channels: "
                + ", ".join(item.name for item in self.channels)
            )
        chosen = self._newest_revisions(list(joints.values()), refuse_others=not numbers)
        given = [self.revision(number) for number in numbers]
        for revision in given:
            if revision.channel not in joints:
                raise InputError(
                    f"revision {revision.number} belongs to {revision.channel}, which is not a joint"
                )
        _refuse_several([revision.channel for revision in given])
        chosen |= {revision.channel: revision for revision in given}
        from palpate.export.target_terms import FittedJoint  # noqa: PLC0415, only for exports

        fitted, failures = list[FittedJoint](), list[str]()
        for name, joint in joints.items():
            kept = chosen.get(name)
            effects: Sequence[str] = ()
            if kept is not None:
                self.check(self.revision(kept.number))
                joint, effects = self.channel_of(kept), kept.effects  # noqa: PLW2901, with its base model
            try:
                fit = self.fit(joint, effects)
            except InputError as error:
                failures.append(f"{name}: {error}")
                continue
            model = " + ".join([joint.model.name, *effects])
            fitted.append(FittedJoint(name, model, joint.kind, joint.effort_unit, fit))
        if not fitted:
            raise InputError(failures[0])
        return fitted, failures

    def _newest_revisions(
        self, channels: Sequence[StudyChannel], *, refuse_others: bool
    ) -> dict[str, Revision]:
        """Return each channel's newest revision, by channel; refuse a folder with those of others only."""
        newest = {item.name: kept for item in channels if (kept := self.newest(item)) is not None}
        latest = {revision.channel: revision for revision in self.revisions}
        if not refuse_others or not latest:
            return newest
        for channel in channels:
            if channel.name in latest and channel.name not in newest:
                other = latest[channel.name]
                self.check(other)
                raise InputError(
                    f"the folder has no revision of {channel.name} with base model {channel.model.name}, "
                    f"only with {other.model}; to use that one, add --revision {other.number}"
                )
        if not newest:
            raise InputError(
                f"{self._file}: the folder has only revisions of other channels ({', '.join(latest)}); they "
                "were made for another file, or with other options (--urdf). Name another folder"
            )
        return newest

    def to_export(self, numbers: Sequence[int] = ()) -> list[Revision]:
        """Return the revisions that `export` writes.

        If none of them is of the only contact, its base model is saved and included.

        Args:
            numbers: numbers of revisions; empty for each channel's newest one.

        Raises:
            InputError: as for `export`, or a revision is of a linear axis, which the simulated arm does not
                have.
        """
        if numbers:
            chosen = [self._revisions.get(number) for number in numbers]
        else:
            chosen = list(self._newest_revisions(self.channels, refuse_others=True).values())
        for revision in chosen:
            self.check(revision)
            if self.channel_of(revision).kind is ChannelKind.PRISMATIC:
                raise InputError(
                    f"{revision.channel}: is a linear axis, but all joints of the simulated arm rotate; "
                    "choose other revisions with --revision, or another --format: feedforward, mjcf, urdf, "
                    "isaaclab or bam"
                )
        contacts = [channel for channel in self.source.channels if channel.kind is ChannelKind.CONTACT]
        if len(contacts) == 1 and not any(item.channel == contacts[0].name for item in chosen):
            base = self.channel(contacts[0].name)
            self._base_world()  # raises before anything is saved
            self._save_stages(base, [], None)
            chosen = [kept for kept in [self.latest(base)] if kept is not None] + chosen
        names = {contact.name for contact in contacts}
        _refuse_several(["contact" if item.channel in names else item.channel for item in chosen])
        if not chosen:
            raise InputError(
                f"{self._file}: has no revision to export, and a joint cannot be exported without one; make "
                "one with palpate add or palpate diagnose --apply"
            )
        return chosen

    def _base_world(self) -> "Scenario":
        """Return the world that the models complete: the session's, or the default; InputError if damaged."""
        from palpate.runs.hidden_effects import scenario_of  # noqa: PLC0415, with the simulator
        from palpate.sim_backend.scenario import Scenario  # noqa: PLC0415, likewise

        session = self.source.session
        return (scenario_of(session) if session is not None else None) or Scenario()

    def truth_of(self, channel: ChannelData) -> Mapping[str, float]:
        """Return true parameters of a simulated session: the object's, not the joints'.

        Args:
            channel: channel of this study; empty for a joint, and without a session.
        """
        session = self.source.session
        if session is None or channel.kind is not ChannelKind.CONTACT:
            return {}
        from palpate.runs.hidden_effects import scenario_of, truth_of  # noqa: PLC0415, with the simulator

        return truth_of(scenario_of(session))

    def _plan_probe(
        self, diagnosed: Sequence[ChannelDiagnosis], longest_s: float, progress: Progress
    ) -> NextProbe | None:
        if find_spec("pinocchio") is None:  # plans of a probe are rehearsed with the arm's rigid-body model
            return None
        from palpate.planning.next_probe import next_probe  # noqa: PLC0415, with the simulator

        return next_probe(self, diagnosed, longest_s, progress, processes=os.cpu_count() or 1)

    def _can_plan(self) -> bool:
        if find_spec("pinocchio") is None:
            return False
        from palpate.planning.next_probe import can_plan  # noqa: PLC0415, with the simulator

        return can_plan(self)


def _refuse_several(channels: Sequence[str]) -> None:
    if twice := [name for name in channels if channels.count(name) > 1]:
        raise InputError(f"several revisions of channel {twice[0]}: choose one with --revision")


def _numbers(revisions: int | Sequence[int]) -> Sequence[int]:
    numbers = [revisions] if isinstance(revisions, int) else revisions
    if not isinstance(numbers, list | tuple):
        raise InputError(f"revisions={numbers!r}: give a revision's number, or a list of them")
    return numbers


def arm_from_urdf(path: Path, tip_frame: str | None = None) -> Arm:
    """Read the arm of a URDF file.

    Args:
        path: the file.
        tip_frame: frame of the tip; None for the link "tip", or else the last link.

    Raises:
        InputError: the file does not exist, is not a URDF, or has no such frame.
    """
    existing_file(path, "URDF")
    chosen = tip_frame or TIP_FRAME
    if tip_frame is None:
        with suppress(OSError, ValueError):  # `RigidBody` reports why the file is not a URDF
            robot = parse_urdf(read_text(path))
            if TIP_FRAME not in {link.get("name") for link in robot.findall("link")}:
                chosen = last_link(robot) or TIP_FRAME
    note = (
        f"{path}: no link is called '{TIP_FRAME}', so the tip is the last link, '{chosen}' (see --tip-frame)"
    )
    notes = () if tip_frame is not None or chosen == TIP_FRAME else (note,)
    body = RigidBody.from_urdf(path, chosen)  # checked even if no model needs it
    return Arm(read_text(path), chosen, str(path), notes=notes, joint_names=body.joint_names)


def _refuse_other_units(channels: Sequence[ChannelData], *, is_gain_known: bool = False) -> None:
    """Refuse channels in units that a simulator does not have."""
    for data in channels:
        for what, unit in data.proxy_units.items():
            needed, constant, example = next(PROXIES[name] for name in PROXIES if si_unit(name) == unit)
            turns = data.kind is ChannelKind.REVOLUTE
            quantity = "displacement" if what == "position" else "torque" if turns else "force"
            raise InputError(
                f"{data.name}: its {what} is in {unit}, and a simulator needs {needed}; read the data with "
                f"the {constant}, as in --unit {quantity}={example}"
            )
        if data.kind is ChannelKind.SERVO and not is_gain_known:
            raise InputError(
                f"{data.name}: its effort is a goal error [rad], and a simulator needs N m; for mjcf, urdf, "
                "isaaclab and bam, give the servo's gain [N m/rad] with --servo-gain. For other formats, add "
                "a column torque_Nm with this gain times (goal - position); if positions are numbered, the "
                "columns are torque_1_Nm, ..."
            )


def _path(path: Any, what: str) -> Path:  # noqa: ANN401, whatever a user gives
    if not isinstance(path, Path | str):
        raise InputError(f"{what} {path!r}: give a path")
    return Path(path)
