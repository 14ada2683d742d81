"""Models and recordings that enter the gap workflow."""
