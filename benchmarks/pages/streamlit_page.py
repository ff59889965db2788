"""A Streamlit page for `benchmarks/workbench.py`: one tick, and the same two curves as on the workbench."""

import sys

import plotly.graph_objects as go
import streamlit as st

from palpate.study import Study
from palpate.workbench.plots import DrawnMotion, model_update, time_figure
from palpate.workbench.state import WorkbenchState


@st.cache_resource
def bench() -> WorkbenchState:
    """The study, read once."""
    return WorkbenchState(Study(sys.argv[-1], keep=False))


chosen = ["cubic_stiffness"] if st.checkbox("cubic stiffness") else []
made = bench()
shown = made.show(made.choice.with_effects(chosen))
motion = DrawnMotion.of(made.channel.data)
effort, left = shown.fitted.at(shown.fitted.values), shown.fitted.residual
figure = time_figure(motion, shown.base.at(shown.base.values), shown.base.residual)
values, traces = model_update(motion, effort, left, None)
for place, number in enumerate(traces):
    figure["data"][number]["y"] = values["y"][place]
st.metric("error in held-out runs", f"{shown.fitted.rmse:.5f}")
st.plotly_chart(go.Figure(data=figure["data"], layout=figure["layout"]))
