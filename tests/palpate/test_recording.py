"""Rerun recordings of a session and of a model's revisions."""

from dataclasses import replace

import numpy as np
import pytest
from rerun.chunk import RrdReader

from palpate.render.build import result_view
from palpate.render.recording.file import REVISION, TIME, shown_on
from palpate.render.recording.revisions import HEIGHT, WIDTH, Chart, _revision_markdown, record_rerun, ticks
from palpate.render.recording.scene import PICTURES_HZ, Scene, _load_urdf, _moving_joints, picture_rows
from palpate.render.recording.session import record_session
from palpate.render.view import BudgetView, StudyView
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Event
from palpate.study import Study
from tests.palpate import synthetic
from tests.palpate.presses import write_presses

TRUTH = {"stiffness.k": synthetic.STIFFNESS, "damping.c": synthetic.DAMPING}


@pytest.fixture(scope="module")
def scene():
    events = (Event(5.333, "touch", "touched"),)
    ticks = synthetic.ticks()
    ticks["time_s"] = ticks["time_s"] + 5.001
    return Scene(
        "test", ticks, synthetic.urdf(), events, surface_m=-synthetic.SURFACE_M, truth=TRUTH, summary="# Hi"
    )


@pytest.fixture(scope="module")
def recording(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "test.rrd"
    record_session(scene, path)
    return path


def column_values(path, entity, component):
    """All rows of one component, in the order in which they were sent."""
    return [value for _, value in rows_of(RrdReader(path).stream().to_chunks(), entity, component)]


def test_forces_torques_and_depth_of_every_tick_are_there(scene, recording):
    rows = column_values(recording, "/contact/force", "Scalars:scalars")
    assert len(rows) == len(scene.ticks["force_n"])
    np.testing.assert_allclose([row[1] for row in rows], scene.ticks["force_n"])
    rows = np.array(column_values(recording, "/torque/joint_2", "Scalars:scalars"))
    np.testing.assert_allclose(rows[1:, 0], scene.ticks["torque_measured_nm"][1:, 1])
    assert np.isnan(rows[0, 0])  # the torque was off
    np.testing.assert_allclose(rows[:, 1], scene.ticks["torque_sent_nm"][:, 1])

    depth_mm = np.array(column_values(recording, "/contact/displacement", "Scalars:scalars"))[:, 0]
    expected = 1e3 * (synthetic.SURFACE_M - scene.ticks["tip_position_world_m"][:, 2])
    np.testing.assert_allclose(depth_mm, expected, atol=1e-9)


def test_phases_and_events_are_logged_as_text(recording):
    states = [row[0] for row in column_values(recording, "/phase", "StateChange:state")]
    assert states[:5] == ["approach", "loading", "hold", "unloading", "retract"]
    assert len(states) == 15
    assert column_values(recording, "/events", "TextLog:text") == [["touch: touched"]]


def test_times_and_names_are_those_of_the_session(scene, recording):
    """Times count from a whole second of the session's clock, which may be that of the computer's start."""
    found = {}
    for chunk in RrdReader(recording).stream().to_chunks():
        batch = chunk.to_record_batch()
        if TIME in batch.schema.names:
            times_s = batch.column(TIME).cast("int64").to_numpy() / 1e9
            found[chunk.entity_path] = np.append(found.get(chunk.entity_path, []), times_s)
    for entity in ("/contact/force", "/torque/joint_1", "/timing/lateness"):
        np.testing.assert_allclose(found[entity], scene.ticks["time_s"] - 5.0, atol=1e-9)
    np.testing.assert_allclose(found["/events"], [0.333])
    assert found["/phase"][0] == pytest.approx(0.001)
    assert column_values(recording, "/torque/joint_1", "SeriesLines:names") == [["measured", "sent"]]


def test_arm_moves_through_all_its_joints_in_order():
    tree = _load_urdf(synthetic.urdf())
    assert [joint.name for joint in _moving_joints(tree)] == ["joint_1", "joint_2", "joint_3"]


def test_pictures_are_few_and_include_the_last_tick(scene):
    rows = picture_rows(scene.time_s)
    assert rows[-1] == len(scene.time_s) - 1
    assert len(rows) == pytest.approx(PICTURES_HZ * np.ptp(scene.time_s), rel=0.02)


def test_session_without_contact_and_urdf_is_recorded(tmp_path):
    ticks = synthetic.ticks((0.15,))
    free = {name: values[:200] for name, values in ticks.items()}
    record_session(Scene("free", free, ""), tmp_path / "free.rrd")
    assert column_values(tmp_path / "free.rrd", "/contact/force", "Scalars:scalars")
    assert not column_values(tmp_path / "free.rrd", "/contact/displacement", "Scalars:scalars")


def test_stopped_arm_without_reference_is_recorded(scene, tmp_path):
    ticks = {name: np.array(values) for name, values in scene.ticks.items()}
    lost = "press_direction_world tip_position_world_m torque_commanded_nm reference_position_rad"
    for name in lost.split():
        ticks[name][-50:] = np.nan
    ticks["phase"][-50:] = 8
    stopped = Scene("stopped", ticks, synthetic.urdf(), surface_m=-synthetic.SURFACE_M)
    record_session(stopped, tmp_path / "stopped.rrd")
    ((center,),) = column_values(tmp_path / "stopped.rrd", "/object", "Boxes3D:centers")
    ((turn,),) = column_values(tmp_path / "stopped.rrd", "/object", "Boxes3D:quaternions")
    assert center[2] == pytest.approx(synthetic.SURFACE_M - 0.025)
    assert np.abs(turn) == pytest.approx([0.0, 1.0, 0.0, 0.0])  # upside down, as it is pressed from above


def test_missing_folder_is_refused_and_nothing_is_left(scene, tmp_path):
    with pytest.raises(InputError, match="cannot write"):
        record_session(scene, tmp_path / "none" / "x.rrd")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    study = Study(write_presses(tmp_path_factory.mktemp("grown") / "hard.csv"), keep=False)
    return study.result(study.channel(), ["layered_stiffness", "cubic_stiffness"])


@pytest.fixture(scope="module")
def chunks(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "grown.rrd"
    record_rerun(StudyView("grown", (result_view(result),)), path)
    return [
        chunk for chunk in RrdReader(path).stream().to_chunks() if chunk.entity_path.startswith("/contact")
    ]


def rows_of(chunks, entity, component):
    """Rows (revision or None, value) of one component."""
    rows = []
    for chunk in chunks:
        if chunk.entity_path == entity:
            batch = chunk.to_record_batch()
            names = [name for name in batch.schema.names if name.endswith(component)]
            revisions = batch.column("revision").to_pylist() if "revision" in batch.schema.names else None
            for name in names:
                values = batch.column(name).to_pylist()
                rows += zip(revisions or [None] * len(values), values, strict=True)
    return rows


def test_each_revision_has_its_curve_and_the_last_fits_the_measurement(chunks):
    ((at, measured),) = rows_of(chunks, "/contact/effort/a_measured", "LineStrips2D:strips")
    revisions, models = zip(*rows_of(chunks, "/contact/effort/model", "LineStrips2D:strips"), strict=True)
    assert (at, revisions) == (None, (0, 1, 2))

    def off(model, run):
        """The largest distance between two curves, each thinned in its own way, over the same time."""
        (x, y), (at, measured) = np.transpose(model), np.transpose(run)
        return np.abs(np.interp(at, x, y) - measured).max()

    distance = [max(off(*pair) for pair in zip(model, measured, strict=True)) for model in models]
    assert distance[2] < distance[0] / 3


def test_recording_shows_error_noise_and_added_effect_of_each_revision(result, chunks):
    rows = rows_of(chunks, "/contact/error", "Scalars:scalars")
    assert [revision for revision, _ in rows] == [0, 1, 2]
    errors, noise = np.transpose([levels for _, levels in rows])
    np.testing.assert_allclose(errors, [stage.rmse for stage in result.stages])
    np.testing.assert_allclose(noise, result.noise.value)
    texts = dict(rows_of(chunks, "/contact/words", "TextDocument:text"))
    assert "base model" in texts[0][0]
    assert "**+ cubic_stiffness**" in texts[2][0]
    judged = replace(result_view(result), budget=BudgetView("Of the 3 N error: relaxation 90 %.", ()))
    assert _revision_markdown(judged, 2).splitlines()[:3] == [judged.budget.sentence, "", "### Revision 2"]


def test_chart_maps_its_corners_to_the_corners():
    chart = Chart("c", (1.0, 3.0), (-5.0, 5.0), "x", "y")
    placed = chart.place(np.array([1.0, 3.0]), np.array([-5.0, 5.0]))
    np.testing.assert_allclose(placed, [[0, HEIGHT], [WIDTH, 0]])


@pytest.mark.parametrize(
    ("span", "expected"),
    [
        ((0.0, 10.0), [0, 2, 4, 6, 8, 10]),
        ((-0.3, 0.72), [-0.25, 0.0, 0.25, 0.5]),
        ((1234.0, 1239.0), [1234, 1235, 1236, 1237, 1238, 1239]),
    ],
)
def test_rules_are_at_round_values_within_the_frame(span, expected):
    np.testing.assert_allclose(ticks(*span), expected)


def test_every_sample_is_shown_over_time_with_both_models_and_residuals(result, chunks):
    effort = np.array([row for _, row in rows_of(chunks, "/contact/time/effort", "Scalars:scalars")])
    assert effort.shape == (len(result.channel.data), 3)
    np.testing.assert_allclose(effort[:, 0], result.channel.data.effort)
    np.testing.assert_allclose(effort[:, 2], result.stages[-1].fitted.predicted)
    left = np.array([row for _, row in rows_of(chunks, "/contact/time/residual", "Scalars:scalars")])
    np.testing.assert_allclose(left[:, 1], result.stages[-1].fitted.residual)


@pytest.mark.parametrize(("timeline", "play"), [(REVISION, "following"), (TIME, "paused")])
def test_recording_of_revisions_opens_at_the_last_one(timeline, play):
    assert shown_on(timeline=timeline).time_panel.play_state == play  # what is followed is the end
