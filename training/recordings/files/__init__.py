"""Files of recordings: CAN logs, measurement files and tables."""
