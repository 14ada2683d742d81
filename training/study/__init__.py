"""The paper's study: preparation, input selection, linear models, 29 NARX models, outcome."""
