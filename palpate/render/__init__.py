"""Results as people see them: one view model (`view`), drawn by rich, plotly and Rerun."""
