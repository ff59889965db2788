"""The Rerun recording holds what the session holds."""

import numpy as np
import pytest
from rerun.chunk import RrdReader

from palpate.render.recording.scene import PICTURES_HZ, PressedBlock, Scene, load_urdf, moving_joints
from palpate.render.recording.session import record_session
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Event
from tests.palpate import synthetic

TRUTH = {"stiffness.k": synthetic.STIFFNESS, "damping.c": synthetic.DAMPING}


@pytest.fixture(scope="module")
def scene():
    events = (Event(0.333, "touch", "touched"),)
    ticks = synthetic.ticks()
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
    rows = []
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.entity_path == entity:
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if name.endswith(component):
                    rows += batch.column(name).to_pylist()
    return rows


def test_forces_and_torques_of_every_tick_are_there(scene, recording):
    rows = column_values(recording, "/contact/force", "Scalars:scalars")
    assert len(rows) == len(scene.ticks["force_n"])
    np.testing.assert_allclose([row[1] for row in rows], scene.ticks["force_n"])
    rows = np.array(column_values(recording, "/torque/joint_2", "Scalars:scalars"))
    np.testing.assert_allclose(rows[1:, 0], scene.ticks["torque_measured_nm"][1:, 1])
    assert np.isnan(rows[0, 0])  # the torque was off
    np.testing.assert_allclose(rows[:, 1], scene.ticks["torque_sent_nm"][:, 1])


def test_phases_and_events_are_told_in_words(recording):
    states = [row[0] for row in column_values(recording, "/phase", "StateChange:state")]
    assert states[:5] == ["approach", "loading", "hold", "unloading", "retract"]
    assert len(states) == 15
    assert column_values(recording, "/events", "TextLog:text") == [["touch: touched"]]


def test_the_displacement_is_counted_from_the_surface(scene, recording):
    depth_mm = np.array(column_values(recording, "/contact/displacement", "Scalars:scalars"))[:, 0]
    expected = 1e3 * (synthetic.SURFACE_M - scene.ticks["tip_position_world_m"][:, 2])
    np.testing.assert_allclose(depth_mm, expected, atol=1e-9)


def test_the_arm_moves_through_all_its_joints_in_order():
    tree = load_urdf(synthetic.urdf())
    assert [joint.name for joint in moving_joints(tree)] == ["joint_1", "joint_2", "joint_3"]


def test_pictures_are_few_and_include_the_last_tick(scene):
    rows = scene.picture_rows
    assert rows[-1] == len(scene.time_s) - 1
    assert len(rows) == pytest.approx(PICTURES_HZ * scene.time_s[-1], rel=0.02)


def test_a_session_without_contact_and_urdf_is_recorded_too(tmp_path):
    ticks = synthetic.ticks((0.15,))
    free = {name: values[:200] for name, values in ticks.items()}
    record_session(Scene("free", free, ""), tmp_path / "free.rrd")
    assert column_values(tmp_path / "free.rrd", "/contact/force", "Scalars:scalars")
    assert not column_values(tmp_path / "free.rrd", "/contact/displacement", "Scalars:scalars")


def test_a_stopped_arm_without_reference_is_recorded_too(scene, tmp_path):
    ticks = {name: np.array(values) for name, values in scene.ticks.items()}
    for name in (
        "press_direction_world",
        "tip_position_world_m",
        "torque_commanded_nm",
        "reference_position_rad",
    ):
        ticks[name][-50:] = np.nan
    ticks["phase"][-50:] = 8
    stopped = Scene("stopped", ticks, synthetic.urdf(), surface_m=-synthetic.SURFACE_M)
    record_session(stopped, tmp_path / "stopped.rrd")
    heights = np.array(column_values(tmp_path / "stopped.rrd", "/object/top", "Mesh3D:vertex_positions")[0])
    assert np.isfinite(heights).all()


def test_a_folder_that_is_not_there_is_refused_and_nothing_is_left(scene, tmp_path):
    with pytest.raises(InputError, match="cannot write"):
        record_session(scene, tmp_path / "none" / "x.rrd")
    assert not list(tmp_path.iterdir())


class TestBlock:
    """The block that gives way under the tip."""

    center = np.array([0.4, 0.0, 0.1])
    press = np.array([0.0, 0.0, -1.0])

    def test_it_is_as_deep_as_measured_under_the_tip_and_stays_at_its_rim(self):
        tip = self.center + 0.012 * self.press
        vertices, _ = PressedBlock(self.center, self.press).pressed(tip[None], np.array([0.012]))
        assert (self.center[2] - vertices[0, :, 2]).max() == pytest.approx(0.012, rel=1e-6)
        block = PressedBlock(self.center, self.press)
        vertices, _ = block.pressed(self.center[None], np.array([0.02]))
        rim = np.abs(vertices[0, :, 0] - self.center[0]) > 0.08
        assert (self.center[2] - vertices[0, rim, 2]).max() < 0.001

    def test_normals_stand_on_the_surface(self):
        tips, depth = self.center[None] + [[0.01, 0.005, 0.0]], np.array([0.015])
        press = np.array([0.3, -0.2, -0.9]) / np.linalg.norm([0.3, -0.2, -0.9])
        block = PressedBlock(self.center, press)
        vertices, normals = block.pressed(tips, depth)
        grid, normal_grid = (values[0].reshape(33, 33, 3) for values in (vertices, normals))
        along = grid[2:, 1:-1] - grid[:-2, 1:-1]
        across = grid[1:-1, 2:] - grid[1:-1, :-2]
        by_difference = np.cross(along, across)
        by_difference /= np.linalg.norm(by_difference, axis=-1, keepdims=True)
        cosine = np.abs(np.einsum("ijk,ijk->ij", by_difference, normal_grid[1:-1, 1:-1]))
        assert cosine.min() > 0.99
        assert (normals[0] @ press < 0).all()
