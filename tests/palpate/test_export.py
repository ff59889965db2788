"""`palpate export`: the improved model as a world, viewer layouts, and tables."""

import json
from dataclasses import replace
from functools import partial
from xml.etree import ElementTree

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from palpate.control.loop.task import Phase
from palpate.estimation.channel import Surface
from palpate.estimation.effects import EFFECTS
from palpate.export.scenario import ARM, CONTACT, JOINT, SENSOR, FittedChannel, export_scenario
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Event, Session, SessionMetadata, write_session, writer
from palpate.sim_backend.imperfection import IMPERFECTIONS
from palpate.sim_backend.scenario import Scenario, load_scenario
from palpate.study import Study
from tests.estimation.swings import swings
from tests.palpate import synthetic
from tests.palpate.cli import as_json, assert_refused, done, next_commands, run
from tests.palpate.presses import write_presses, write_table
from tests.palpate.sessions import EVENTS, synthetic_session

pytestmark = pytest.mark.usefixtures("without_figures")


def fitted(channel, runs=0, surface=None, **values):
    told = {name.replace("__", "."): value for name, value in values.items()}
    return FittedChannel(channel, told, surface, runs)


def test_every_simulator_effect_has_a_fitted_counterpart():
    known = {**CONTACT, **JOINT, **ARM, **SENSOR}
    # a gain is found by calibration, not by a fit; a dead band by the contact and by the joints; an encoder
    # zero is a bias
    assert set(known) - {"force_deadband", "encoder_zero"} == set(IMPERFECTIONS) - {"sensor_gain"}


@pytest.mark.parametrize(
    ("terms", "channel"),
    [(CONTACT, "contact"), (SENSOR, "contact"), (JOINT, "joint_2"), (ARM, "joint_2"), (SENSOR, "joint_2")],
)
def test_typical_values_of_every_effect_can_be_exported(terms, channel):
    """What lies in the middle of an effect's typical range is taken, or refused with a reason."""
    for name in terms:
        effect = EFFECTS[name]()
        parameters = {}
        for parameter in (*effect.gains, *effect.inner):
            low, high = parameter.typical
            parameters[f"{name}__{parameter.name}"] = float(np.sqrt(low * high)) if low > 0 else high / 2
        spring = {"stiffness__k": 500.0, "damping__c": 20.0} if channel == "contact" else {}
        export = export_scenario(Scenario(), [fitted(channel, 3, **spring, **parameters)], "x")
        if name == "hunt_crossley":
            assert export.left_out == () or "hunt_crossley" in export.left_out[0]
            continue
        assert not export.left_out, name
        simulated = {"force_deadband": "deadband", "encoder_zero": "bias"}.get(name, name)
        assert simulated in {entry.name for entry in export.scenario.hidden}


@pytest.mark.parametrize(
    ("presliding_m", "slip_m", "lost"), [(1e-7, 1e-6, 1), (1e-6, 1e-6, 0), (2e-4, 2e-4, 0)]
)
def test_immediate_friction_reversal_is_exported_at_the_fastest_rate(presliding_m, slip_m, lost):
    shown = {"force": 2.0, "presliding": presliding_m, "transition": 0.004}
    parameters = {"stiffness__k": 500.0} | {f"dry_friction__{name}": value for name, value in shown.items()}
    export = export_scenario(Scenario(), [fitted("contact", **parameters)], "x")
    (friction,) = export.scenario.hidden
    assert (friction.friction_n, friction.slip_m) == (2.0, slip_m)
    assert len(export.left_out) == lost
    assert all("presliding of 1e-07 m and transition of 0.004 m/s" in line for line in export.left_out)


def test_arm_parameters_are_exported_once():
    """Every joint shows the tilt of the base, and the dead band of the force sensor."""
    shown = {"gravity_tilt__tilt": 0.1, "force_deadband__width": 0.3}
    joints = [fitted(f"joint_{number}", 3, **shown) for number in (1, 2)]
    export = export_scenario(Scenario(), joints, "x")
    assert [(e.name, e.channels[0]) for e in export.scenario.hidden] == [
        ("gravity_tilt", "joint_1"),
        ("deadband", "contact"),
    ]
    assert len(export.left_out) == 2
    assert all("taken from joint_1" in line for line in export.left_out)


def test_tilt_of_a_turning_arm_has_both_angles():
    joints = [fitted(f"joint_{n}", 3, gravity_tilt__pitch=0.1, gravity_tilt__roll=-0.2) for n in (1, 2)]
    (entry,) = export_scenario(Scenario(), joints, "x").scenario.hidden
    assert (entry.pitch_rad, entry.roll_rad) == (0.1, -0.2)


def pressed(**more):
    """A spring of 500 N/m that the sensor first shows at 49 mm along the press."""
    return fitted("contact", 0, Surface(0.049, 1e-6), stiffness__k=500.0, damping__c=20.0, **more)


def test_encoder_zeros_become_biases_of_the_encoders_and_move_the_surface():
    joints = [fitted(f"joint_{n}", 3, encoder_zero__joint_2=0.05) for n in (1, 2)]
    export = export_scenario(Scenario(), [pressed(), *joints], "x")
    (zero,) = export.scenario.hidden
    assert (zero.name, zero.channel, zero.bias) == ("bias", "encoder_2", 0.05)
    taken, surface = export.left_out
    assert "taken from joint_1" in taken
    assert "surface_height_m" in surface


def dead_bands(found):
    return [one.half_width for one in found.scenario.hidden if one.name == "deadband"]


def test_deadband_found_in_joints_applies_to_the_start_of_contact():
    joint = fitted("joint_1", 3, force_deadband__width=0.5)
    alone, both = (
        export_scenario(load_scenario("default"), [contact, joint], "as fitted")
        for contact in (pressed(), pressed(deadband__width=0.45))
    )
    assert (dead_bands(alone), dead_bands(both)) == ([0.5], [0.45])
    assert alone.scenario.object.surface_height_m == pytest.approx(-0.048)  # 0.5 N is 1 mm of the spring
    assert both.scenario.object.surface_height_m == pytest.approx(-0.049)
    assert any("force_deadband" in line for line in both.left_out)


def test_unsupported_simulator_terms_are_reported():
    unknown = fitted("contact", stiffness__k=500.0, mystery__a=1.0)
    export = export_scenario(Scenario(), [unknown], "x")
    assert export.left_out == ("contact: the simulator has no effect 'mystery'",)
    negative = fitted("contact", stiffness__k=5.0, lag__tau=-1.0)
    assert "lag" in export_scenario(Scenario(), [negative], "x").left_out[0]
    pushing = fitted("contact", stiffness__k=5.0, damping__c=-3.0)
    assert "a damping of -3 N s/m would add energy" in export_scenario(Scenario(), [pushing], "x").used[1]


def test_wrong_motor_constant_is_inverted():
    (entry,) = export_scenario(Scenario(), [fitted("joint_1", 3, torque_gain__gain=0.8)], "x").scenario.hidden
    assert entry.gain == pytest.approx(1.25)


@pytest.mark.parametrize("base", [0.2, 0.9, 0.0])
def test_viscosity_of_joint_and_directions_is_one_effect(base):
    """Data show only the sum of the viscosities, so a fit may split it in any way, with a negative part."""
    directions = {f"asymmetric_friction__viscous_{way}": 0.5 - base for way in ("forward", "backward")}
    levels = {"asymmetric_friction__forward": 0.6, "asymmetric_friction__backward": 0.4}
    joint = fitted("joint_2", 3, viscous_friction__d=base, **levels, **directions)
    export = export_scenario(Scenario(), [joint], "x")
    assert [
        entry.viscous_nms_rad for entry in export.scenario.hidden if entry.name == "viscous_friction"
    ] == [pytest.approx(0.5)]
    assert not export.left_out


@pytest.mark.parametrize(("position", "effort"), [("position_m", "force_N"), ("position_rad", "torque_Nm")])
def test_only_a_turning_joint_becomes_part_of_the_simulated_arm(position, effort, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    swing = swings(2)
    columns = {"time_s": swing.time_s, position: swing.position, effort: swing.effort, "run": swing.run}
    data = write_table(tmp_path / "axis.csv", **columns)
    done("add", data, "coulomb_friction", "--model", "inertia")
    result = run("export", data, "-o", "world.yaml")
    if position == "position_m":
        assert_refused(result, "joint_1: is a linear axis")
        assert not (tmp_path / "world.yaml").exists()
    else:
        assert load_scenario(tmp_path / "world.yaml").description.endswith("the object was not measured")


def test_imported_file_becomes_an_object(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = write_presses(tmp_path / "hard.csv")
    assert run("add", data, "cubic_stiffness").exit_code == 0
    assert as_json("export", data, "-o", tmp_path / "world.yaml")["left_out"] == []
    world = load_scenario(tmp_path / "world.yaml")
    assert world.object.law.stiffness_n_m == pytest.approx(400, rel=0.01)
    assert world.hidden[0].cubic_n_m3 == pytest.approx(2e6, rel=0.02)
    assert_refused(run("export", data, "-o", tmp_path / "world.yaml"), "already exists")
    assert_refused(run("export", data, "-o", tmp_path / "world.html"), "must end in .yaml or .yml")
    assert_refused(run("report", data, "-o", tmp_path / "page.csv"), "must end in .html or .htm")
    assert not (tmp_path / "page.csv").exists()


def test_unreadable_world_leaves_no_revision(probed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recorded = Session.open(probed[0])
    ticks = recorded.samples("tick")
    metadata = replace(recorded.metadata, scenario="object: [unfinished")
    session = write_session(
        tmp_path / "s.mcap", [(ticks.stream, {name: ticks[name] for name in ticks})], metadata
    )
    assert_refused(run("export", session, "-o", tmp_path / "world.yaml"), "its scenario line 1")
    assert list(tmp_path.iterdir()) == [session]


def test_inadequate_base_model_is_exported_with_a_warning(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hardening, linear = (write_presses(tmp_path / f"{cubic}.csv", cubic=cubic) for cubic in (2e6, 0.0))
    said = " ".join(done("export", hardening).stderr.split())
    assert "contact: kelvin_voigt does not fit: The error of" in said
    assert "A simulation with this model differs from the measurement" in said
    assert "does not fit" not in done("export", linear).stderr


@pytest.mark.slow
@pytest.mark.usefixtures("log_in_process")
def test_world_reproduces_the_measured_force(tmp_path):
    """Probe an object with something hidden, find it, and probe what was found, by another noise."""
    hidden = tmp_path / "hidden.yaml"
    hidden.write_text("hidden: [{effect: stress_relaxation, stiffness_n_m: 250.0, time_s: 0.2}]\n")
    first, again = tmp_path / "first.mcap", tmp_path / "again.mcap"
    probe = ("probe", "--speed-mm-s", "150,90", "--hold-s", "0.4", "--seed")
    assert run(*probe, 5, "--out", first, "--hidden", hidden).exit_code == 0
    assert run("add", first, "stress_relaxation").exit_code == 0
    exported, world = run("export", first), tmp_path / "first" / "scenario.yaml"
    assert ["replay", str(first), "--scenario", str(world)] in next_commands(exported)
    assert run(*probe, 6, "--out", again, "--scenario", world).exit_code == 0
    for number in range(2):
        measured, simulated = (force_of(path, number) for path in (first, again))
        count = min(len(measured), len(simulated))
        left = measured[:count] - simulated[:count]
        assert np.sqrt(np.mean(left**2)) < 0.05 * np.sqrt(np.mean(measured**2))


def force_of(session, number):
    """Force of one run from the touch until the end of the hold."""
    ticks = Session.open(session).samples("tick")
    mine = (ticks["run"] == number) & np.isin(ticks["phase"], [Phase.LOADING, Phase.HOLD])
    return ticks["force_n"][mine]


def test_revisions_of_other_rows_are_not_continued(tmp_path, monkeypatch):
    """One file of two specimens, the second softer: the name of the file is all that its revisions share."""
    monkeypatch.chdir(tmp_path)
    hard, soft = write_presses(tmp_path / "a.csv"), write_presses(tmp_path / "b.csv", cubic=0.0, seed=5)
    header, *first = hard.read_text().splitlines()
    rows = [f"{row},A" for row in first] + [f"{row},B" for row in soft.read_text().splitlines()[1:]]
    (tmp_path / "two.csv").write_text("\n".join([f"{header},specimen", *rows]) + "\n")

    def grown(name, *effects, start=None):
        return Study("two.csv", where={"specimen": name}).add(*effects, start=start).revisions

    of_a, of_b = (("export", "two.csv", "--where", f"specimen={name}") for name in "AB")
    grown("A", "cubic_stiffness")
    for told in ((), ("--revision", 1)):
        assert_refused(run(*of_b, *told), "revision 1 is from other data", "--where", "folder")
    assert not (tmp_path / "two-palpate" / "scenario.yaml").exists()
    with pytest.raises(InputError, match="revision 1 is from other data"):
        grown("B", "bias", start=1)
    assert [(one.parent, one.effects) for one in grown("B", "bias")] == [(None, []), (2, ["bias"])]
    for of, law in ((of_a, "cubic_stiffness"), (of_b, "bias")):
        assert law in run(*of, "--json").stdout


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return synthetic_session(tmp_path_factory.mktemp("layout") / "touch.mcap")


def series_of(program, path):
    """What the layout shows, as "stream.column", with the number of a wide column's value."""
    if program == "foxglove":
        panels = json.loads(path.read_text())["configById"].values()
        return [one["value"] for panel in panels for one in panel["paths"]]
    curves = ElementTree.parse(path).getroot().iter("curve")
    return [one.get("name").replace("/", ".", 1) for one in curves]


@pytest.mark.parametrize("program", ["foxglove", "plotjuggler"])
def test_every_curve_is_a_value_of_the_session(program, session, tmp_path):
    done("export", session, "--layout", program, "-o", tmp_path / "layout")
    shown, ticks = series_of(program, tmp_path / "layout"), Session.open(session).samples("tick")
    assert {"tick.force_n", "tick.joint_position_rad[2]", "tick.phase"} <= set(shown)
    for one in shown:
        name, _, number = one.partition(".")[2].rstrip("]").partition("[")
        assert ticks.vector(name).shape[1] > int(number or 0)
        assert (number == "") == (ticks.vector(name).shape[1] == 1)


@pytest.mark.parametrize("program", ["foxglove", "plotjuggler"])
def test_long_session_shows_the_first_value_of_each_message(program, tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "_MANY", 10)
    session = synthetic_session(tmp_path / "long.mcap")
    result = run("export", session, "--layout", program, "-o", tmp_path / "layout")
    assert "it shows only every " in result.stderr
    assert {"tick.force_n[0]", "tick.joint_position_rad[2]"} <= set(series_of(program, tmp_path / "layout"))


def test_foxglove_layout_places_every_panel_and_plotjuggler_stacks_its_plots(session, tmp_path):
    """Plotjuggler's plot_docker.cpp writes "-" for a splitter that is vertical, and "|" for side by side."""
    run("export", session, "--layout", "foxglove", "-o", tmp_path / "panels")
    layout = json.loads((tmp_path / "panels").read_text())

    def placed(tree):
        return [tree] if isinstance(tree, str) else placed(tree["first"]) + placed(tree["second"])

    assert placed(layout["layout"]) == list(layout["configById"])
    run("export", session, "--layout", "plotjuggler", "-o", tmp_path / "layout")
    (split,) = ElementTree.parse(tmp_path / "layout").getroot().iter("DockSplitter")
    assert split.get("orientation") == "-"
    assert len(split.get("sizes").split(";")) == len(split) == int(split.get("count"))


def test_session_without_streams_has_no_layout(tmp_path):
    path = write_session(tmp_path / "x.mcap", [], SessionMetadata())
    assert_refused(run("export", path, "--layout", "foxglove"), "no stream with anything to plot")


def exported(path, name, file):
    done("export", path, "--stream", name, "-o", file)
    return pyarrow.parquet.read_table(file) if file.suffix == ".parquet" else pyarrow.csv.read_csv(file)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_stream_is_read_back_exactly(session, tmp_path, ending):
    table, ticks = exported(session, "tick", tmp_path / f"t{ending}"), synthetic.ticks()
    assert table.num_rows == len(ticks["time_s"])
    for name, values in (
        ("time_s", ticks["time_s"]),
        ("joint_position_rad_2", ticks["joint_position_rad"][:, 1]),
    ):
        np.testing.assert_array_equal(table[name].to_numpy(), values)


def test_parquet_keeps_units_and_events_are_a_table_with_their_text(session, tmp_path):
    table = exported(session, "tick", tmp_path / "t.parquet")
    assert table.schema.field("torque_sent_nm_3").metadata[b"unit"] == b"N m"
    table = exported(session, "events", tmp_path / "e.parquet").to_pydict()
    assert table["text"] == [event.text for event in EVENTS]
    table = exported(session, "events", tmp_path / "e.csv").to_pydict()
    assert table["text"] == [event.text.replace("\x1b", " ") for event in EVENTS]
    assert json.loads(table["data"][0]) == {"run": 0}


def test_session_without_channels_exports_streams_and_events(tmp_path):
    path = write_session(tmp_path / "x.mcap", [], SessionMetadata(), [Event(0.5, "start", "it begins", None)])
    assert exported(path, "events", tmp_path / "e.csv")["time_s"].to_pylist() == [0.5]
    assert_refused(run("export", path, "--stream", "tick", "-o", tmp_path / "t.csv"), "Available: events")


def test_channel_is_imported_again_unchanged(probed, tmp_path):
    file = tmp_path / "contact.csv"
    exported(probed[0], "contact", file)
    first, again = (Study(path, keep=False).channel("contact").data for path in (probed[0], file))
    for name in ("position", "velocity", "effort", "phase"):
        np.testing.assert_array_equal(getattr(first, name)[first.run >= 0], getattr(again, name))
    assert 0.0 < again.position_step == pytest.approx(first.position_step)
    assert "not used" not in run("import", file, "--look").stdout
    stored = tmp_path / "again.mcap"
    done("import", file, "-o", stored)
    (expected, *_), *others = (
        as_json("estimate", path)["channels"][0]["estimates"] for path in (probed[0], file, stored)
    )
    for estimate, *_ in others:
        for name, known in expected["parameters"].items():
            found = estimate["parameters"][name]
            assert found["value"] == pytest.approx(known["value"], abs=0.02 * known["std_err"])
            assert found["std_err"] == pytest.approx(known["std_err"], rel=0.01)
    told = run("export", probed[0], "--stream", "contact", "-o", file, "--force")
    assert next_commands(told) == [["import", str(file)]]


def test_effort_without_a_constant_keeps_its_unit(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = swings(3)
    columns = {"time [s]": data.time_s, "run": data.run, "position [rad]": data.position}
    path = write_table(tmp_path / "swing.csv", **columns, **{"Current [mA]": 1e3 * data.effort})
    done("import", path, "-o", "swing.mcap")
    done("export", path, "--stream", "joint_1", "-o", "joint.csv")
    assert (tmp_path / "joint.csv").read_text().startswith("# column 'Current [mA]' is a current used as")
    for source in (path, tmp_path / "swing.mcap", tmp_path / "joint.csv"):
        study = Study(source, "pendulum", keep=False)
        units = {name: each.unit for name, each in study.fit("joint_1").parameters.items()}
        assert units["pendulum.gravity"] == study.channel().effort_unit == "A", source
        assert (units["pendulum.inertia"], units["viscous_friction.d"]) == ("A s^2/rad", "A s/rad")
        study.export_feedforward(tmp_path / "ff.yaml")
        assert "effort_unit: A\n" in (tmp_path / "ff.yaml").read_text()
        study.add("coulomb_friction")
        for export in (study.export, partial(study.export_simulator, target="isaaclab")):
            with pytest.raises(InputError, match=r"its effort is in A, and .*0\.5Nm/A"):
                export(tmp_path / "refused")


def test_strain_and_stress_are_exported_as_such(tmp_path):
    strain = np.linspace(0.0, 0.1, 200)
    path = write_table(tmp_path / "pull.csv", **{"strain [mm/mm]": strain, "stress [kPa]": 9.0 * strain})
    done("export", path, "--stream", "contact", "-o", tmp_path / "contact.csv")
    for source in (path, tmp_path / "contact.csv"):
        (contact,) = Study(source, keep=False).source.channels
        np.testing.assert_allclose(contact.effort, 9e3 * strain)
        assert (contact.effort_unit, contact.position_unit) == ("Pa", "strain")


def test_default_output_is_in_the_results_folder(session):
    told = as_json("export", session, "--stream", "tick")
    assert told["table"] == str(session.with_suffix("") / "tick.csv")
    assert "force_n" in told["columns"]
    told = as_json("export", session, "--layout", "plotjuggler")
    assert told["layout"] == str(session.with_suffix("") / "plotjuggler.xml")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--layout", "excel"), ("excel", "foxglove")),
        (("--layout", "foxglove", "--stream", "tick"), ("--stream and --layout",)),
        (("--stream", "nope"), ("no stream or channel 'nope'", "events, tick, contact, joint_1")),
        (("--stream", "joint_9"), ("no stream or channel 'joint_9'", "contact, joint_1")),
        (("--stream", "tick", "-o", "x.xlsx"), ("x.xlsx", ".csv or .parquet")),
        (("--stream", "tick", "--revision", 1), ("--revision",)),
        (("--stream", "tick", "-o", "SESSION"), (".csv or .parquet",)),
    ],
)
def test_invalid_export_is_refused(session, options, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(run("export", session, *(session if one == "SESSION" else one for one in options)), *words)
    assert list(tmp_path.iterdir()) == []
