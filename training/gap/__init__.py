"""The gap workflow: where a model and a healthy vehicle disagree, and which effect is missing."""
