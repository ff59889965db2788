"""The plots are made from the data, in one style, without touching matplotlib's global state."""

import matplotlib as mpl
import numpy as np
import pytest

from estimation.channel import ChannelData, ChannelKind
from palpate.views import style
from palpate.views.plots.force_displacement import force_displacement_figure
from palpate.views.plots.force_time import force_time_figure
from palpate.views.plots.phase_strip import stretches
from palpate.views.plots.residual import residual_figure
from palpate.views.plots.torque import torque_figure
from palpate.views.runs import runs_by_speed
from tests.palpate import synthetic


@pytest.fixture(scope="module")
def ticks():
    return synthetic.ticks()


@pytest.fixture(scope="module")
def contact(ticks):
    return contact_of(ticks)


def contact_of(ticks):
    depth = synthetic.SURFACE_M - ticks["tip_position_world_m"][:, 2]
    speed = -ticks["tip_velocity_world_m_s"][:, 2]
    acceleration = np.gradient(speed, synthetic.PERIOD_S)
    return ChannelData(
        "contact",
        ChannelKind.CONTACT,
        ticks["time_s"],
        depth,
        speed,
        acceleration,
        ticks["force_n"],
        ticks["run"],
        ticks["phase"],
    )


def line_data(figure, index=0):
    return figure.axes[index].lines


def test_runs_are_ordered_and_named_by_speed(contact):
    runs = runs_by_speed(contact)
    assert [run.label for run in runs] == ["60 mm/s", "90 mm/s", "150 mm/s"]
    assert [run.number for run in runs] == [2, 1, 0]
    assert len({run.color for run in runs}) == 3


def test_the_speed_of_data_without_phases_is_that_of_its_quick_part(contact):
    unknown = contact.select(contact.run == 0)
    unknown = ChannelData(
        **{
            f: getattr(unknown, f) for f in ("name", "kind", "time_s", "position", "velocity", "acceleration")
        },
        effort=unknown.effort,
        run=unknown.run,
        phase=np.full(len(unknown), -1),
    )
    (run,) = runs_by_speed(unknown)
    assert run.speed_m_s == pytest.approx(0.15, rel=0.05)


def test_torques_show_each_joint_with_what_was_sent(ticks):
    with style.house_style():
        figure = torque_figure(ticks)
    for joint in range(3):
        sent, measured = line_data(figure, joint)
        np.testing.assert_array_equal(measured.get_ydata(), ticks["torque_measured_nm"][:, joint])
        np.testing.assert_array_equal(sent.get_ydata(), ticks["torque_sent_nm"][:, joint])


def test_a_measured_torque_is_judged_by_the_command_that_held_when_it_was_sampled(ticks):
    obeyed = dict(ticks)
    obeyed["torque_measured_nm"] = np.roll(ticks["torque_sent_nm"], 1, axis=0) + 0.25
    obeyed["torque_at_s"] = ticks["time_s"] - 0.5e-3
    with style.house_style():
        figure = torque_figure(obeyed)
    assert [panel.get_title(loc="right") for panel in figure.axes[:3]] == ["rms difference 0.250 N m"] * 3


def test_force_displacement_has_units_and_a_curve_for_each_run_and_its_model(contact):
    with style.house_style():
        figure = force_displacement_figure(contact, 0.9 * contact.effort, "model")
    assert len(line_data(figure)) == 6
    assert "[mm]" in figure.axes[0].get_xlabel()
    assert "[N]" in figure.axes[0].get_ylabel()
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["60 mm/s", "90 mm/s", "150 mm/s", "model"]


def test_force_over_time_starts_shortly_before_the_touch(contact, ticks):
    with style.house_style():
        figure = force_time_figure(contact, ticks["desired_force_n"], None)
    first = figure.axes[0]
    assert first.get_xlim()[0] == pytest.approx(-0.15, abs=0.002)
    assert [axes.get_title(loc="left") for axes in figure.axes[:3]] == ["60 mm/s", "90 mm/s", "150 mm/s"]


def test_many_runs_are_represented_by_a_few(ticks):
    many = contact_of(synthetic.ticks(tuple(np.linspace(0.05, 0.15, 9))))
    with style.house_style():
        figure = force_time_figure(many, None, None)
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]
    assert (titles[0], titles[-1], len(titles)) == ("50 mm/s", "150 mm/s", 4)


def test_residuals_show_only_what_was_fitted(contact):
    used = contact.position > 0
    with style.house_style():
        figure = residual_figure(contact, np.where(used, 0.01, 99.0), used, 0.05)
    shown = np.concatenate([line.get_ydata() for line in line_data(figure) if len(line.get_ydata()) > 2])
    assert len(shown) == used.sum()
    assert np.abs(shown).max() == pytest.approx(0.01)


@pytest.mark.parametrize("seconds", [0.05, 300.0])
def test_slow_and_quick_data_are_drawn(contact, seconds):
    scaled = ChannelData(
        "contact",
        ChannelKind.CONTACT,
        contact.time_s * seconds,
        contact.position,
        contact.velocity / seconds,
        contact.acceleration,
        contact.effort,
        np.zeros(len(contact), int),
        np.full(len(contact), -1),
    )
    with style.house_style():
        assert force_time_figure(scaled, None, None).axes
        assert force_displacement_figure(scaled, None, "").axes


def test_the_legend_covers_no_data(contact):
    with style.house_style():
        figure = force_displacement_figure(contact, contact.effort, "model")
        figure.draw_without_rendering()
    legend, axes = figure.legends[0].get_window_extent(), figure.axes[0].get_window_extent()
    assert not legend.overlaps(axes)


def test_the_style_ends_with_its_block():
    before = dict(mpl.rcParams)
    with style.house_style():
        assert mpl.rcParams["axes.grid"]
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("values", "expected"),
    [([], []), ([3], [(0, 1)]), ([1, 1, 2, 2, 2, 1], [(0, 2), (2, 5), (5, 6)])],
)
def test_stretches_of_equal_values(values, expected):
    assert stretches(np.array(values, int)) == expected
