"""The paper's study: preparation, input selection, linear baselines, 29 NARX models, choice."""
