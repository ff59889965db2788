"""Choose the experiment that separates explanations which the present data do not separate."""
