"""The response rule: bank of sensor hypotheses, their evidence, and readings that do not move."""
