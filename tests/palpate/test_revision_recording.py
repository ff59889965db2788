"""The Rerun recording of a model that grows."""

import numpy as np
import pytest
from rerun.chunk import RrdReader

from palpate.render.build import result_view
from palpate.render.recording.file import REVISION, TIME, shown_on
from palpate.render.recording.revisions import HEIGHT, WIDTH, Chart, record_rerun, ticks
from palpate.render.view import StudyView
from palpate.study import Study
from tests.palpate.presses import write_presses


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


def test_each_revision_has_its_own_curve_and_the_measurement_is_always_there(chunks):
    model = rows_of(chunks, "/contact/effort/model", "LineStrips2D:strips")
    assert [revision for revision, _ in model] == [0, 1, 2]
    measured = rows_of(chunks, "/contact/effort/a_measured", "LineStrips2D:strips")
    assert [revision for revision, _ in measured] == [None]


def test_the_last_model_lies_on_the_measurement_and_the_first_does_not(chunks):
    (_, measured), *_ = rows_of(chunks, "/contact/effort/a_measured", "LineStrips2D:strips")
    models = [strips for _, strips in rows_of(chunks, "/contact/effort/model", "LineStrips2D:strips")]

    def off(model, run):
        """The largest distance between two curves, each thinned in its own way, over the same time."""
        (x, y), (at, measured) = np.transpose(model), np.transpose(run)
        return np.abs(np.interp(at, x, y) - measured).max()

    distance = [max(off(*pair) for pair in zip(model, measured, strict=True)) for model in models]
    assert distance[2] < distance[0] / 3


def test_the_error_of_each_revision_stands_beside_the_noise(result, chunks):
    rows = rows_of(chunks, "/contact/error", "Scalars:scalars")
    assert [revision for revision, _ in rows] == [0, 1, 2]
    errors, noise = np.transpose([levels for _, levels in rows])
    np.testing.assert_allclose(errors, [stage.rmse for stage in result.stages])
    np.testing.assert_allclose(noise, result.noise.value)


def test_words_say_what_was_added(chunks):
    texts = dict(rows_of(chunks, "/contact/words", "TextDocument:text"))
    assert "base model" in texts[0][0]
    assert "**+ cubic_stiffness**" in texts[2][0]


def test_a_chart_puts_its_corners_into_the_corners():
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
def test_rules_stand_at_round_values_within_the_frame(span, expected):
    np.testing.assert_allclose(ticks(*span), expected)


def test_every_sample_is_there_over_time_with_both_models_and_what_they_leave(result, chunks):
    effort = np.array([row for _, row in rows_of(chunks, "/contact/time/effort", "Scalars:scalars")])
    assert effort.shape == (len(result.channel.data), 3)
    np.testing.assert_allclose(effort[:, 0], result.channel.data.effort)
    np.testing.assert_allclose(effort[:, 2], result.stages[-1].fitted.predicted)
    left = np.array([row for _, row in rows_of(chunks, "/contact/time/residual", "Scalars:scalars")])
    np.testing.assert_allclose(left[:, 1], result.stages[-1].fitted.residual)


@pytest.mark.parametrize(("timeline", "play"), [(REVISION, "following"), (TIME, "paused")])
def test_a_recording_of_revisions_opens_at_the_last_one(timeline, play):
    assert shown_on(timeline=timeline).time_panel.play_state == play  # what is followed is the end
