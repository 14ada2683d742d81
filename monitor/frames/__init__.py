"""Step 1: logs and measurement files become CAN frames, one file per format."""
